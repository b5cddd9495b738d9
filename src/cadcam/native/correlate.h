/* Correlation of a picture with a template in any orientation. Planes are (height, width) float, row by row; the centre
 * of the first pixel is (0, 0). Every value must be finite: the caller checks. */
#ifndef CADCAM_CORRELATE_H
#define CADCAM_CORRELATE_H

#include "raster.h"

typedef struct {
    const float *pixels;
    int32_t width, height;
} cc_plane;

/* A template in `count` orientations on the grid of the plane: tap t lies (dx[t], dy[t]) from the position. */
typedef struct {
    cc_plane plane;
    const int32_t *dx, *dy;
    const float *weight; /* (count, taps): of zero mean and unit length over the taps that count */
    const float *inside; /* (masks, taps): 1 where a tap counts, else 0; masks is 1 or count */
    int32_t taps, count, masks;
    int32_t either_sign;  /* 1: the size of the correlation counts, not its sign */
    float least_variance; /* of the picture under the template; 0 is the correlation where it has less */
    float *best;          /* (height, width): normalised correlation in the best orientation; 0 where taps leave
                           * the plane */
    int32_t *which;       /* (height, width): that orientation, -1 alike */
} cc_search;

/* A template as points of its own plane with what a motion changes there: value (n) of zero mean and unit length,
 * slope (motions, n) orthogonal to it and to constants; inverse (motions, motions) of slope slope^T. Motions are two
 * shifts (px of the plane), a turn (rad) and, if there is a fourth, the logarithm of the scale. */
typedef struct {
    cc_plane plane;
    const float *u, *v, *value, *slope;
    const double *inverse;
    int32_t n, motions;
    int32_t cubic;      /* between pixels: 1 the cubic spline through them, 0 bilinear */
    int32_t iterations; /* at most */
    double settled;     /* px: a step that moves no point by more ends */
    double reach;       /* px: a pose that moves farther from its start is given up, its score 0 */
    double radius;      /* of the points about their origin, px */
} cc_register;

/* Steps of brightness from (dx_in, dy_in) to (dx_out, dy_out) about each pixel, in eight directions: (out - in) by
 * (out + in), or its negative unless `dark`; sums below `level` count as that. */
typedef struct {
    cc_plane plane;
    int32_t dx_in[8], dy_in[8], dx_out[8], dy_out[8];
    int32_t reach; /* px that no step goes beyond */
    int32_t dark;
    float level;
    float *response; /* (height, width): the second weakest of the eight; not written within `reach` of the outline */
} cc_spots;

/* Means over blocks of factor x factor pixels; the last ones of a row or column may be smaller. `out` has the size
 * rounded up. */
CC_API void cc_shrink(const cc_plane *plane, int32_t factor, float *out);
CC_API void cc_find_spots(const cc_spots *task);
/* Rows `from` to `to` - 1 of the result; 0, or -1 where memory is short. */
CC_API int32_t cc_search_rows(const cc_search *search, int32_t from, int32_t to);
/* Move `count` poses (x, y, angle, scale) to where the correlation is highest near them; score (count) is it there. 0,
 * or -1 where memory is short. */
CC_API int32_t cc_register_poses(const cc_register *task, double *pose, double *score, int32_t count);

/* Second moments (count, motions, motions) of what pulls at poses: of the sum of slopes times what the template, at the
 * picture's gain, does not explain. What two points say counts as one matter by how much of a square of `side` px (a
 * power of two) at the one lies in that at the other. Points lie whole px apart. shown, alike: slopes times those that
 * the picture has there, at its gain. Of a task between cubic pixels. 0, or -1 where memory is short. */
CC_API int32_t cc_register_pulls(const cc_register *task, int32_t side, const double *pose, double *moment,
                                 double *shown, int32_t count);

#endif
