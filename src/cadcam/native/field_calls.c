/* The functions of field.h, each in the instruction set in use. */
#include "field.h"

#include "bodies.h"

/* Whether none of four corners is farther from the other's than the root of far2. */
static int near_each_other(const double *a, const double *b, double far2) {
    for (int i = 0; i < 12; i += 3) {
        const double x = a[i] - b[i], y = a[i + 1] - b[i + 1], z = a[i + 2] - b[i + 2];
        if (!(x * x + y * y + z * z <= far2)) return 0;
    }
    return 1;
}

CC_API void cc_reduce(const float *in, int64_t stride, int32_t width, int32_t height, int32_t k, float *out) {
    IN_USE(field_reduce)(in, stride, width, height, k, out);
}

CC_API void cc_directions(const float *in, int32_t width, int32_t height, float floor, float *scratch, uint8_t *planes,
                          float *mean, float *variance) {
    IN_USE(field_directions)(in, width, height, floor, scratch, planes, mean, variance);
}

CC_API void cc_halve(const uint8_t *in, int32_t width, int32_t height, uint8_t *planes, float *mean, float *variance) {
    IN_USE(field_halve)(in, width, height, planes, mean, variance);
}

CC_API void cc_slide(const cc_pose_edges *edges, int32_t eye, const double *poses, int32_t centre_x, int32_t centre_y,
                     int32_t reach_x, int32_t reach_y, int32_t keep, int32_t apart, uint16_t *scratch, int32_t *shift,
                     float *score) {
    IN_USE(climb_slide)(edges, eye, poses, centre_x, centre_y, reach_x, reach_y, keep, apart, scratch, shift, score);
}

CC_API void cc_sweep(const cc_pose_edges *edges, int32_t eye, const double *poses, int32_t keep, int32_t apart,
                     uint8_t *scratch, int32_t *shift, float *score) {
    IN_USE(sweep_field)(edges, eye, poses, keep, apart, scratch, shift, score);
}

CC_API void cc_climb(const cc_pose_edges *edges, double *poses, const double *freedom, int32_t n_free,
                     double held, const double *blur, int32_t steps, double *scores) {
    IN_USE(climb_poses)(edges, poses, freedom, n_free, held, blur, steps, scores);
}

CC_API void cc_evidence(const cc_pose_edges *edges, int32_t eye, const double *poses, double blur, const int32_t *line,
                        const double *share, const cc_belief *belief, double *scratch, double *out) {
    IN_USE(climb_evidence)(edges, eye, poses, blur, line, share, belief, scratch, out);
}

CC_API void cc_straighten(const float *in, int32_t width, int32_t height, const float *nodes, int32_t step,
                          int32_t wide, int32_t high, float *out, uint8_t *seen) {
    IN_USE(field_straighten)(in, width, height, nodes, step, wide, high, out, seen);
}

CC_API int64_t cc_firsts(const double *corners, int64_t n, int64_t most, double apart, uint8_t *scratch,
                           int64_t *kept) {
    int64_t found = 0;
    for (int64_t k = 0; k < n; k++) scratch[k] = 0;
    for (int64_t k = 0; k < n && found < most; k++) {
        if (scratch[k]) continue;
        kept[found++] = k;
        for (int64_t j = k + 1; j < n; j++)
            if (!scratch[j]) scratch[j] = (uint8_t)near_each_other(corners + 12 * k, corners + 12 * j, apart * apart);
    }
    return found;
}
