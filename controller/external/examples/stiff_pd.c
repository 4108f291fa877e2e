/* Stiffness, damping and a slow integral per joint, for the three-joint arm `paper_arm`.
 *
 *   cc -O2 $(funnel-hil doctor --includes) -o stiff_pd stiff_pd.c
 *   funnel-hil simulate --set controller.law=external --set 'controller.external.command=[./stiff_pd]'
 */
#include "funnel_hil_law.h"

enum { JOINTS = 3 };
static const double stiffness[JOINTS] = {9000, 16000, 2500}; /* N m / rad */
static const double damping[JOINTS] = {400, 700, 90};        /* N m s / rad */
static const double integral[JOINTS] = {20000, 40000, 6000}; /* N m / (rad s) */
static double sum[JOINTS];                                   /* rad s */

static void reset(void) {
    for (size_t i = 0; i < JOINTS; i++) sum[i] = 0.0;
}

static int torque(const struct funnel_hil_situation *s, double *torque_nm) {
    if (s->joints != JOINTS) return 2;
    for (size_t i = 0; i < JOINTS; i++) {
        double error = s->position_rad[i] - s->reference_position_rad[i];
        double error_rate = s->velocity_rad_s[i] - s->reference_velocity_rad_s[i];
        double wanted = -stiffness[i] * error - damping[i] * error_rate - integral[i] * sum[i];
        double limit = s->torque_limit_nm[i];
        torque_nm[i] = wanted > limit ? limit : wanted < -limit ? -limit : wanted;
        if (torque_nm[i] == wanted) sum[i] += s->step_s * error; /* not while at the limit */
    }
    return 0;
}

int main(void) { return funnel_hil_serve(torque, reset); }
