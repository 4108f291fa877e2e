/* Answers for the next ticks, with targets for the drives: for the three-joint arm `paper_arm`.
 *
 *   cc -O2 $(funnel-hil doctor --includes) -o chunk chunk.c
 *   funnel-hil simulate --set controller.law=external --set 'controller.external.command=[./chunk]' \
 *     --set controller.every=20 --set controller.external.rows=20 \
 *     --set controller.external.targets=true --set controller.drive_feedback.enabled=true
 *
 * The targets are the reference, continued at its present acceleration. The drives are stiff and
 * damped around them; the torques add a slow integral.
 */
#include "funnel_hil_law.h"

enum { JOINTS = 3 };
static const double integral[JOINTS] = {20000, 40000, 6000}; /* N m / (rad s) */
static const double period_s = 0.001;                        /* between rows: 1 / rate_hz */
static double sum[JOINTS];                                   /* rad s */

static void reset(void) {
    for (size_t i = 0; i < JOINTS; i++) sum[i] = 0.0;
}

static int torque(const struct funnel_hil_situation *s, double *torque_nm) {
    if (s->joints != JOINTS || s->target_position_rad == NULL) return 2;
    for (size_t row = 0; row < s->rows; row++) {
        double ahead_s = (double)row * period_s;
        for (size_t i = 0; i < JOINTS; i++) {
            size_t at = row * JOINTS + i;
            double velocity = s->reference_velocity_rad_s[i];
            double change = ahead_s * s->reference_acceleration_rad_s2[i];
            sum[i] += period_s * (s->position_rad[i] - s->reference_position_rad[i]);
            torque_nm[at] = -integral[i] * sum[i];
            s->target_velocity_rad_s[at] = velocity + change;
            s->target_position_rad[at] =
                s->reference_position_rad[i] + ahead_s * (velocity + 0.5 * change);
        }
    }
    return 0;
}

int main(void) { return funnel_hil_serve(torque, reset); }
