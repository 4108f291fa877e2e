/* A control law in C for funnel-hil: `controller.law: external`.
 *
 * Write a function that fills in torques, hand it to funnel_hil_serve, and name the program in
 * `controller.external.command`. Anything printed has to go to stderr: stdout carries the answers.
 */
#ifndef FUNNEL_HIL_LAW_H
#define FUNNEL_HIL_LAW_H

#include <stdio.h>
#include <stdlib.h>

enum { FUNNEL_HIL_RESET = 0, FUNNEL_HIL_TORQUE = 1, FUNNEL_HIL_VERSION = 1 };
enum { FUNNEL_HIL_HEADER = 8, FUNNEL_HIL_ROWS = 8 };

/* A situation; arrays have one value per joint and are valid until the function returns. */
struct funnel_hil_situation {
    size_t joints;
    double time_s;    /* since the start of the run, of the measurement or, with delay
                         compensation, of the moment in which the torque will act */
    double step_s;    /* since the measurement of the question before; 0 at the first */
    double horizon_s; /* how far this lies ahead of its measurement; 0 unless predicted */
    const double *position_rad, *velocity_rad_s;
    const double *reference_position_rad, *reference_velocity_rad_s, *reference_acceleration_rad_s2;
    const double *upper_bound_rad, *lower_bound_rad; /* position - reference stays between them */
    const double *torque_limit_nm;                   /* inf for none */
    size_t rows; /* of an answer: `controller.external.rows` */
    double *target_position_rad, *target_velocity_rad_s; /* to be filled in, rows x joints; NULL
                                       without `controller.external.targets` */
};

/* Fill in torque_nm, one value per joint; 0 for success, another number ends the run with it.
 * With several rows, joint i of row r is at [r * joints + i]; row r is for the r-th tick after the
 * measurement. */
typedef int (*funnel_hil_torque)(const struct funnel_hil_situation *, double *torque_nm);
/* Forget everything; may be NULL for a law without a memory. */
typedef void (*funnel_hil_reset)(void);

/* Answer until the run is over; the exit code for main. */
static int funnel_hil_serve(funnel_hil_torque torque, funnel_hil_reset reset) {
    double header[FUNNEL_HIL_HEADER], *rows = NULL, *answer = NULL, *targets = NULL;
    size_t joints = 0, values = 0, size = 0;
    while (fread(header, sizeof(double), FUNNEL_HIL_HEADER, stdin) == FUNNEL_HIL_HEADER) {
        if (header[1] != FUNNEL_HIL_VERSION) {
            fprintf(stderr, "version %g of the protocol is not %d\n", header[1], FUNNEL_HIL_VERSION);
            return 1;
        }
        if (rows == NULL) {
            joints = (size_t)header[2];
            values = (size_t)header[6] * joints;
            size = 1 + (header[7] != 0.0 ? 3 : 1) * values;
            rows = (double *)calloc(FUNNEL_HIL_ROWS * joints, sizeof(double));
            answer = (double *)calloc(size, sizeof(double));
            if (rows == NULL || answer == NULL) return 1;
            targets = header[7] != 0.0 ? answer + 1 + values : NULL;
        }
        if (fread(rows, sizeof(double), FUNNEL_HIL_ROWS * joints, stdin) != FUNNEL_HIL_ROWS * joints)
            return 1;
        answer[0] = 0.0;
        if (header[0] == FUNNEL_HIL_RESET) {
            if (reset != NULL) reset();
        } else {
            const struct funnel_hil_situation situation = {
                joints, header[3], header[4], header[5],
                rows, rows + joints, rows + 2 * joints, rows + 3 * joints, rows + 4 * joints,
                rows + 5 * joints, rows + 6 * joints, rows + 7 * joints,
                (size_t)header[6], targets, targets == NULL ? NULL : targets + values};
            answer[0] = torque(&situation, answer + 1);
        }
        if (fwrite(answer, sizeof(double), size, stdout) != size || fflush(stdout))
            return 1;
    }
    free(rows);
    free(answer);
    return 0;
}

#endif
