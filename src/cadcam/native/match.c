/* The functions of correlate.h, each in the instruction set in use. */
#include "bodies.h"

CC_API void cc_shrink(const cc_plane *plane, int32_t factor, float *out) { IN_USE(shrink)(plane, factor, out); }

CC_API void cc_find_spots(const cc_spots *task) { IN_USE(spots)(task); }

CC_API int32_t cc_search_rows(const cc_search *search, int32_t from, int32_t to) {
    return IN_USE(search_rows)(search, from, to);
}

CC_API int32_t cc_register_poses(const cc_register *task, double *pose, double *score, int32_t count) {
    return IN_USE(register_poses)(task, pose, score, count);
}

CC_API int32_t cc_register_pulls(const cc_register *task, int32_t side, const double *pose, double *moment,
                                 double *shown, int32_t count) {
    return IN_USE(register_pulls)(task, side, pose, moment, shown, count);
}
