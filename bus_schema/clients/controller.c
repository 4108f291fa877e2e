/* A controller in C over zenoh-pico; it knows nothing of funnel-hil.
 *
 *     ./controller [PLANT_ENDPOINT]
 *
 * By default that of its environment, as `controller.process` gives it. It is a Zenoh client of the plant. Torques are PD around `joint_reference`, so the plant has to
 * run with `link.publish_reference: true`. All names are in the order of the states. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
#include <zenoh-pico.h>

#define HASH "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
#define TYPE_AND_HASH "sensor_msgs::msg::dds_::JointState_/" HASH
#define LARGEST 4096
#define MOST_JOINTS 32

static const double stiffness_nm_rad = 4000.0, damping_nm_s = 300.0;
static z_owned_publisher_t commands;
static uint8_t gid[16];
static int64_t sequence;
static volatile int is_over;

/* Where the doubles of a JointState stand in its CDR bytes; offsets count from the 4-byte header. */
typedef struct {
    uint8_t bytes[LARGEST];
    size_t size, names_end; /* behind the names: three sequences of doubles */
    uint32_t joints;
    double position[MOST_JOINTS], velocity[MOST_JOINTS];
} joint_state_t;

static uint32_t read_u32(joint_state_t *s, size_t *at) {
    uint32_t value = 0;
    *at = (*at + 3) & ~(size_t)3;
    if (*at + 8 <= s->size) memcpy(&value, s->bytes + 4 + *at, 4);
    *at += 4;
    return value;
}

static int read_doubles(joint_state_t *s, size_t *at, double *to) {
    uint32_t count = read_u32(s, at);
    if (count > MOST_JOINTS) return -1;
    if (count) *at = (*at + 7) & ~(size_t)7;
    if (4 + *at + 8 * count > s->size) return -1;
    memcpy(to, s->bytes + 4 + *at, 8 * count);
    *at += 8 * count;
    return (int)count;
}

static int read_state(const z_loaned_sample_t *sample, joint_state_t *s) {
    z_bytes_reader_t reader = z_bytes_get_reader(z_sample_payload(sample));
    s->size = z_bytes_reader_read(&reader, s->bytes, LARGEST);
    size_t at = 8; /* behind sec and nanosec */
    uint32_t frame_length = read_u32(s, &at); /* with its closing zero, as all strings */
    at += frame_length;
    s->joints = read_u32(s, &at);
    if (s->joints > MOST_JOINTS) return -1;
    for (uint32_t j = 0; j < s->joints; ++j) {
        uint32_t length = read_u32(s, &at);
        if (length > s->size) return -1;
        at += length;
    }
    s->names_end = at;
    int n = (int)s->joints;
    return read_doubles(s, &at, s->position) == n && read_doubles(s, &at, s->velocity) == n ? 0 : -1;
}

static joint_state_t reference, state;

static void on_reference(z_loaned_sample_t *sample, void *context) {
    (void)context;
    if (read_state(sample, &reference) != 0) reference.joints = 0;
}

static size_t put_u32(uint8_t *body, size_t at, uint32_t value) {
    while (at % 4) body[at++] = 0;
    memcpy(body + at, &value, 4);
    return at + 4;
}

static void on_state(z_loaned_sample_t *sample, void *context) {
    (void)context;
    if (read_state(sample, &state) != 0 || state.joints != reference.joints) return;
    uint8_t *body = state.bytes + 4; /* header, stamp and names are those of the state */
    size_t at = put_u32(body, state.names_end, 0); /* no positions: torques alone */
    at = put_u32(body, at, 0);                     /* no velocities */
    at = put_u32(body, at, state.joints);
    while (at % 8) body[at++] = 0;
    for (uint32_t j = 0; j < state.joints; ++j, at += 8) {
        double torque_nm = stiffness_nm_rad * (reference.position[j] - state.position[j]) +
                           damping_nm_s * (reference.velocity[j] - state.velocity[j]);
        memcpy(body + at, &torque_nm, 8);
    }
    uint8_t attachment[33] = {0};
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    int64_t source_time_ns = now.tv_sec * 1000000000LL + now.tv_nsec;
    ++sequence;
    memcpy(attachment, &sequence, 8);
    memcpy(attachment + 8, &source_time_ns, 8);
    attachment[16] = 16;
    memcpy(attachment + 17, gid, 16);
    z_owned_bytes_t payload, beside;
    z_bytes_copy_from_buf(&payload, state.bytes, 4 + at);
    z_bytes_copy_from_buf(&beside, attachment, sizeof attachment);
    z_publisher_put_options_t options;
    z_publisher_put_options_default(&options);
    options.attachment = z_move(beside);
    z_publisher_put(z_loan(commands), z_move(payload), &options);
}

static void on_plant(z_loaned_sample_t *sample, void *context) {
    (void)context;
    if (z_sample_kind(sample) == Z_SAMPLE_KIND_DELETE) is_over = 1;
}

static z_result_t open_session(z_owned_session_t *session, const char *plant_endpoint) {
    z_owned_config_t config;
    z_config_default(&config);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_MODE_KEY, "client");
    zp_config_insert(z_loan_mut(config), Z_CONFIG_CONNECT_KEY, plant_endpoint);
    return z_open(session, z_move(config), NULL);
}

int main(int argc, char **argv) {
    const char *plant = argc == 2 ? argv[1] : getenv("FUNNEL_HIL_PLANT_ENDPOINT"); /* of `controller.process` */
    if (plant == NULL) return fprintf(stderr, "usage: %s PLANT_ENDPOINT\n", argv[0]), 2;
    z_owned_session_t session;
    while (open_session(&session, plant) != Z_OK) usleep(100000); /* the plant is not there yet */
    zp_start_read_task(z_loan_mut(session), NULL);
    zp_start_lease_task(z_loan_mut(session), NULL);
    z_id_t id = z_info_zid(z_loan(session));
    memcpy(gid, id.id, 16);

    z_view_keyexpr_t key;
    z_publisher_options_t options;
    z_publisher_options_default(&options);
    options.congestion_control = Z_CONGESTION_CONTROL_BLOCK;
    z_view_keyexpr_from_str(&key, "0/joint_commands/" TYPE_AND_HASH);
    z_declare_publisher(z_loan(session), &commands, z_loan(key), &options);

    z_owned_subscriber_t subscribers[3];
    z_owned_closure_sample_t closure;
    z_closure(&closure, on_reference, NULL, NULL);
    z_view_keyexpr_from_str(&key, "0/joint_reference/" TYPE_AND_HASH);
    z_declare_subscriber(z_loan(session), &subscribers[0], z_loan(key), z_move(closure), NULL);
    z_closure(&closure, on_state, NULL, NULL);
    z_view_keyexpr_from_str(&key, "0/joint_states/" TYPE_AND_HASH);
    z_declare_subscriber(z_loan(session), &subscribers[1], z_loan(key), z_move(closure), NULL);
    z_closure(&closure, on_plant, NULL, NULL);
    z_view_keyexpr_from_str(&key, "@ros2_lv/0/*/*/*/NN/*/*/funnel_hil_plant");
    z_liveliness_declare_subscriber(z_loan(session), &subscribers[2], z_loan(key), z_move(closure), NULL);

    /* Once all is ready: from here on the plant knows of a publisher of commands, and starts. */
    char token_key[512], hex[33] = "";
    int length = 16;
    while (length > 1 && id.id[length - 1] == 0) --length;
    for (int i = 0; i < length; ++i) /* an id is a number: most significant byte first */
        snprintf(hex + 2 * i, 3, "%02x", id.id[length - 1 - i]);
    snprintf(token_key, sizeof token_key,
             "@ros2_lv/0/%s/0/1/MP/%%/%%/my_controller/%%joint_commands/" TYPE_AND_HASH "/::,10:,:,:,,",
             hex[0] == '0' ? hex + 1 : hex);
    z_owned_liveliness_token_t token;
    z_view_keyexpr_from_str(&key, token_key);
    z_liveliness_declare_token(z_loan(session), &token, z_loan(key), NULL);

    /* The plant's token goes when it leaves; where the connection goes first, silence has to do. */
    int64_t last = 0;
    for (int silent_ms = 0; !is_over && silent_ms < 5000; silent_ms += 10) {
        if (last != sequence || last == 0) silent_ms = 0;
        last = sequence;
        usleep(10000);
    }
    z_close(z_loan_mut(session), NULL);
    return 0;
}
