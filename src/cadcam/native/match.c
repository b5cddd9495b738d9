/* The entrances to correlate.c: each goes to the instruction set in use. */
#include "correlate.h"
#include "internal.h"

#define DECLARED(suffix)                                                                          \
    void shrink##suffix(const cc_plane *plane, int32_t factor, float *out);                       \
    void spots##suffix(const cc_spots *task);                                                     \
    int32_t search_rows##suffix(const cc_search *search, int32_t from, int32_t to);               \
    void register_poses##suffix(const cc_register *task, double *pose, double *score, int32_t count);
DECLARED(_baseline)
#if CC_HAS_V3
DECLARED(_v3)
#define CHOSEN(name) (variant_in_use() == 1 ? name##_v3 : name##_baseline)
#else
#define CHOSEN(name) name##_baseline
#endif

CC_API void cc_shrink(const cc_plane *plane, int32_t factor, float *out) { CHOSEN(shrink)(plane, factor, out); }

CC_API void cc_find_spots(const cc_spots *task) { CHOSEN(spots)(task); }

CC_API int32_t cc_search_rows(const cc_search *search, int32_t from, int32_t to) {
    return CHOSEN(search_rows)(search, from, to);
}

CC_API void cc_register_poses(const cc_register *task, double *pose, double *score, int32_t count) {
    CHOSEN(register_poses)(task, pose, score, count);
}
