/* The functions of field.h, each in the instruction set in use. */
#include "field.h"

#include "internal.h"

CC_API void cc_reduce(const float *in, int64_t stride, int32_t width, int32_t height, int32_t k, float *out)
    IN_USE(field_reduce, (const float *, int64_t, int32_t, int32_t, int32_t, float *),
           (in, stride, width, height, k, out))

CC_API void cc_directions(const float *in, int32_t width, int32_t height, float floor, float *scratch, uint8_t *planes,
                          float *mean, float *variance)
    IN_USE(field_directions, (const float *, int32_t, int32_t, float, float *, uint8_t *, float *, float *),
           (in, width, height, floor, scratch, planes, mean, variance))

CC_API void cc_halve(const uint8_t *in, int32_t width, int32_t height, uint8_t *planes, float *mean, float *variance)
    IN_USE(field_halve, (const uint8_t *, int32_t, int32_t, uint8_t *, float *, float *),
           (in, width, height, planes, mean, variance))

CC_API void cc_slide(const cc_views *views, int32_t eye, const double *poses, int32_t centre_x, int32_t centre_y,
                     int32_t reach_x, int32_t reach_y, int32_t keep, int32_t apart, uint16_t *scratch, int32_t *shift,
                     float *score)
    IN_USE(climb_slide,
           (const cc_views *, int32_t, const double *, int32_t, int32_t, int32_t, int32_t, int32_t, int32_t, uint16_t *,
            int32_t *, float *),
           (views, eye, poses, centre_x, centre_y, reach_x, reach_y, keep, apart, scratch, shift, score))

CC_API void cc_sweep(const cc_views *views, int32_t eye, const double *poses, int32_t keep, int32_t apart,
                     uint8_t *scratch, int32_t *shift, float *score)
    IN_USE(sweep_field, (const cc_views *, int32_t, const double *, int32_t, int32_t, uint8_t *, int32_t *, float *),
           (views, eye, poses, keep, apart, scratch, shift, score))

CC_API void cc_climb(const cc_views *views, double *poses, const double *freedom, int32_t n_free, const double *blur,
                     int32_t steps, double *scores)
    IN_USE(climb_poses, (const cc_views *, double *, const double *, int32_t, const double *, int32_t, double *),
           (views, poses, freedom, n_free, blur, steps, scores))

CC_API void cc_certainties(const cc_views *views, int32_t eye, const double *poses, double blur, int64_t stride,
                           float *out)
    IN_USE(climb_certainties, (const cc_views *, int32_t, const double *, double, int64_t, float *),
           (views, eye, poses, blur, stride, out))

CC_API void cc_straighten(const float *in, int32_t width, int32_t height, const float *nodes, int32_t step,
                          int32_t wide, int32_t high, float *out, uint8_t *seen)
    IN_USE(field_straighten,
           (const float *, int32_t, int32_t, const float *, int32_t, int32_t, int32_t, float *, uint8_t *),
           (in, width, height, nodes, step, wide, high, out, seen))
