/* The lines of a photo by direction, and how well the edges of a part lie on them.
 *
 * Plain C11 like raster.h; every function writes its answers into memory of the caller. Pictures are (height, width),
 * row by row, pixel (0, 0) centred at (0, 0). A field holds CC_SECTORS planes of bytes: plane s holds the certainty
 * that a line with a normal of direction s pi / CC_SECTORS (modulo pi) runs through a pixel.
 */
#ifndef CADCAM_FIELD_H
#define CADCAM_FIELD_H

#include <stdint.h>

#include "raster.h"

#define CC_SECTORS 8
#define CC_SLIDABLE 257 /* places of a run that are slid: more do not fit 16 bits */

typedef struct {
    const uint8_t *planes; /* (CC_SECTORS, height, width) */
    const float *mean;     /* (CC_SECTORS,) over the picture, */
    const float *variance; /* what a line at a random place meets */
    int32_t width, height;
} cc_field;

/* A field as one camera sees it: q = (fx x/z + skew y/z + cx, fy y/z + cy), and where the camera stands. */
typedef struct {
    cc_field field;
    double fx, skew, cx, fy, cy;
    double rotation[9], translation[3]; /* camera_from_world, rows */
} cc_eye;

/* Places on edges of a part: point (mm), unit tangent, weight: finite, not negative. */
typedef struct {
    float p[3], tangent[3], weight;
} cc_place;

/* What is scored: for each of `poses` (rotation rows, translation: world_from_part) and each eye a run of places. */
typedef struct {
    const cc_eye *eyes;
    const cc_place *places;
    const int64_t *first; /* (poses, eyes) */
    const int32_t *count; /* (poses, eyes) */
    int32_t n_eyes;
    int64_t n_poses;
} cc_pose_edges;

/* Means over boxes of k x k pixels: out (height / k, width / k), what is over at the right and below is left out.
 * `stride` pixels lie between the beginnings of the rows. */
CC_API void cc_reduce(const float *in, int64_t stride, int32_t width, int32_t height, int32_t k, float *out);

/* A picture (wide, high) whose pixels lie in another at places that are known at every `step`-th pixel of every
 * `step`-th row, from (0, 0) to beyond the last: nodes (x, y), NaN for nowhere; between nodes linearly. seen: 1 where
 * the place is in the picture, out: its value there, between pixels linearly; 0 elsewhere. */
CC_API void cc_straighten(const float *in, int32_t width, int32_t height, const float *nodes, int32_t step,
                          int32_t wide, int32_t high, float *out, uint8_t *seen);

/* The field of a picture: planes (CC_SECTORS, height, width), mean and variance (CC_SECTORS,). `floor` is the gradient
 * (grey value per pixel) that counts as noise at least. Scratch of 50 (width + 12) floats. */
CC_API void cc_directions(const float *in, int32_t width, int32_t height, float floor, float *scratch, uint8_t *planes,
                          float *mean, float *variance);

/* The field at half the size (width / 2, height / 2): a line stays as sure as it was. */
CC_API void cc_halve(const uint8_t *in, int32_t width, int32_t height, uint8_t *planes, float *mean, float *variance);

/* Slide the edges of each pose over a window of shifts (pixels) in one eye: |x| <= reach_x, |y| <= reach_y around shift
 * (centre_x, centre_y). Writes the `keep` best of each pose, no two closer than `apart`: shift (2,) and score, the
 * sum above the mean in standard deviations of that at random places. Scratch of
 * (2 reach_x + 16) (2 reach_y + 1) numbers. Fewer than `keep`: score -inf. */
CC_API void cc_slide(const cc_pose_edges *edges, int32_t eye, const double *poses, int32_t centre_x, int32_t centre_y,
                     int32_t reach_x, int32_t reach_y, int32_t keep, int32_t apart, uint16_t *scratch, int32_t *shift,
                     float *score);

/* As cc_slide over the whole field, for many poses near its middle (cx, cy): planes are cut down to levels whose sums
 * fit a byte, places farther than CC_MARGIN px from the middle left out. At most CC_SWEPT places of a run. Writes the
 * `keep` best, no two within `apart`: where the middle comes to lie (2,) and score. Scratch of
 * CC_SECTORS (height + 2 margins + spare) (width + 2 margins + 32) + (width + 32) (height + spare) bytes. */
#define CC_MARGIN 48
#define CC_SPARE 3
#define CC_SWEPT 51
CC_API void cc_sweep(const cc_pose_edges *edges, int32_t eye, const double *poses, int32_t keep, int32_t apart,
                     uint8_t *scratch, int32_t *shift, float *score);

/* Move each pose (in place) uphill: `steps` steps of Gauss-Newton towards the lines within 2.5 blur[step] px along the
 * places' normals, weighted by a Gaussian of that width, in the directions of `freedom` (6, n_free), columns of xi in
 * pose @ exp(xi). held: damping by how places move along their lines, a share of the pull: what few lines tell moves
 * slowly. blur (steps + 1,): the last is that of the judgement. Writes for each pose and eye 4 numbers: sum of
 * weight times certainty in [0, 1] (the best under a Gaussian along the normal), its mean and variance anywhere, sum of
 * weights in the picture. */
CC_API void cc_climb(const cc_pose_edges *edges, double *poses, const double *freedom, int32_t n_free,
                     double held, const double *blur, int32_t steps, double *scores);

/* The evidence of a place for a pose: nats times the certainty there less `even`; of all places of a line at most
 * `most`. A line is seen with probability `seen`, in [0, 1). */
typedef struct { double even, nats, most, seen; } cc_belief;

/* How much more likely the lines of each pose make the picture of one eye, in nats: the sum over them of
 * ln(1 - seen + seen exp(what their places say)). At a place the best certainty under a Gaussian of `blur` px along the
 * normal counts, in [0, 1]; outside the picture none. line: of each of the places of `edges`, a number from 0;
 * share (n_poses,): what part of `nats` a place of that pose is worth. Scratch of as many numbers as lines. */
CC_API void cc_evidence(const cc_pose_edges *edges, int32_t eye, const double *poses, double blur, const int32_t *line,
                        const double *share, const cc_belief *belief, double *scratch, double *out);

/* Which of n poses are kept, best first, as numbers: none of whose corners (n, 4, 3) is farther than `apart` from those
 * of one that is kept already is left out; at most `most`. Returns how many. kept (most,), scratch of n bytes. */
CC_API int64_t cc_firsts(const double *corners, int64_t n, int64_t most, double apart, uint8_t *scratch,
                           int64_t *kept);

#endif
