/* The photo along lines of the model: brightness steps, candidates for these, room around a sample.
 *
 * Plain C11 like raster.h; every function writes its answers into memory of the caller. A picture is (height, width)
 * floats, row by row, pixel (0, 0) centred at (0, 0). A sample is a place q (x, y) on a line and the unit normal there.
 */
#ifndef CADCAM_PROFILE_H
#define CADCAM_PROFILE_H

#include <stdint.h>

#include "raster.h"

typedef struct {
    const float *pixels;
    int32_t width, height;
} cc_picture;

/* Steps that the pixels themselves show in cells around the samples: |along the line| <= half_length, and from
 * -below[i] to above[i] along the normal. Least squares of
 *     I(d) = a + b (d - r(d)) + e r(d) + c Phi(d/blur) + g phi(d/blur)/blur,    r(d) = d Phi(d/blur) + blur phi(d/blur)
 * at the pixels' distances d from the line: a blurred step on ground of another slope on either side. twins: two a
 * sample, one below and one above, (d, slope): a line of the model that steps at d + slope t, t along the line;
 * infinite where there is none. Pixels no darker than `bright`, white, are left out: the light was that or more. Rows
 * along the line are white or not, by their means, and single pixels beside white rows. They count as clipped, and so
 * do those no brighter than `dark`.
 *
 * cc_step_sums writes what the pixels of each cell add up to, CC_STEP_SUMS doubles, the first the number of pixels in
 * use, number CC_STEP_ALL that of all; cc_steps solves for the steps.
 * The slopes are held near 0 with the weights held[2 i], held[2 i + 1], the variance of a pixel over that of the
 * slope. It writes CC_STEP_TERMS doubles a sample: c, g, b, e, sd of the noise, cofactors Qcc Qgg, number of pixels,
 * share of clipped ones; all NaN where the cell leaves the picture or its equations are singular. The step lies at -g/c
 * to first order. */
#define CC_STEP_SUMS 39
#define CC_STEP_ALL 36
#define CC_STEP_TERMS 9
CC_API void cc_step_sums(const cc_picture *picture, int64_t n, const double *q, const double *normal,
                         const double *below, const double *above, const double *twins, double half_length, double blur,
                         double dark, double bright, double *sums);
CC_API void cc_steps(int64_t n, const double *sums, const double *held, double *out);

/* The residuals of those steps, with free slopes, by distance from the line: each cell 2 bins + 1 doubles: sums
 * of it in `bins` bins of `width` px whose middle is at the line, how many pixels each has, and the variance of a
 * pixel; all 0 where there is no step. The other arguments are those that the sums were made with. */
CC_API void cc_step_residuals(const cc_picture *picture, int64_t n, const double *q, const double *normal,
                              const double *below, const double *above, const double *twins, double half_length,
                              double blur, double bright, const double *sums, int32_t bins, double width,
                              double *out);

/* What steps beside lines explain of what is left over in n stretches of cells: of its sums `rest` and numbers of
 * pixels `number` (n, bins <= CC_BAND_BINS), bins as above. variance (n): of a pixel. known (n, CC_BAND_KNOWN): places
 * of other steps that the fits know of, NaN for none; tried (tries): places of steps that they do not, below lines if
 * negative; only those nearer than room (n, 2) below and above are. Writes gain (n, tries), in variances of a pixel: by
 * how much the sum of squares shrinks with such a step beside level, step, its shift, slopes and known steps. 0 where
 * there is no memory, else 1. */
#define CC_BAND_BINS 32
#define CC_BAND_KNOWN 3
CC_API int32_t cc_band_gains(int64_t n, int32_t bins, double width, double blur, const double *rest,
                             const double *number, const double *variance, const double *known, const double *room,
                             int32_t tries, const double *tried, double *gain);

/* Extrema of the slope along each profile, smoothed by a Gaussian of 1 px: `most` of them a sample, the strongest
 * first, no weaker than `least`; offset (px along the normal) and slope (brightness a px, with its sign), NaN where
 * there is no more. The profile is averaged over 2 half_length along the line and reaches from -reach to reach px. */
CC_API void cc_candidates(const cc_picture *picture, int64_t n, const double *q, const double *normal,
                          double half_length, int32_t reach, double least, int32_t most, double *offset, double *slope);

/* Write the values (n, channels) of a picture at places q (n, 2), linear between pixels; NaN outside of it. Channels of
 * a pixel lie side by side. */
CC_API void cc_values_at(const cc_picture *picture, int32_t channels, int64_t n, const double *q, double *values);

/* How far along the normal, and against it, the nearest other line is: free of lines from -below to above, at most
 * `most`. Segments (m, 4) x0 y0 x1 y1 with the run each belongs to and the arc length along it at its two ends; a
 * sample does not see what lies on its own run within `near` px of arc. twins (n, 2, 2): where the nearest line below
 * and above is straight, about parallel and crosses the whole slab: (d, slope) as cc_steps takes them, and in beyond
 * (n, 2) how far there is no line but it; else infinite, and beyond is the room as far as that line. 0 where there is
 * no memory, else 1. */
CC_API int32_t cc_clearance(int64_t n, const double *q, const double *normal, const int32_t *run, const double *arc,
                            int64_t m, const double *segments, const int32_t *segment_run, const double *segment_arc,
                            double half_length, double near, double most, double *below, double *above, double *twins,
                            double *beyond);

/* How lines move across themselves: of n samples with J = dq/d(point in the camera's frame) (n, 2, 3), rotation of the
 * camera from the part (3, 3), p and tangent (n, 3) in the part's frame, the unit normal (n, 2) in the picture and
 * d(place along it)/d(twist of the part) (n, 6). */
CC_API void cc_edge_rows(int64_t n, const double *jacobian, const double *rotation, const double *p,
                         const double *tangent, double *normal, double *row);

/* The same of a camera, K (3, 3), with the part standing at rotation (3, 3), translation (3) in its frame, and where
 * the samples are: q (n, 2); all NaN where they are not in front. lens: its CC_LENS coefficients k1 k2 p1 p2 k3 k4 k5
 * k6 s1 s2 s3 s4 by Brown and Conrady, in OpenCV's order, null for a pinhole; NaN too from `radius` on, in the plane
 * (x, y)/z. */
#define CC_LENS 12
CC_API void cc_camera_rows(int64_t n, const double *K, const double *lens, double radius, const double *rotation,
                           const double *translation, const double *p, const double *tangent, double *q, double *normal,
                           double *row);

/* Means (n, wide) of values (n, wide) over the samples up to `neighbours` before and after that are on the same run, a
 * number of consecutive ones; of the finite ones, 0 where none is. */
CC_API void cc_along_runs(int64_t n, int32_t wide, const double *values, const int32_t *run, int64_t neighbours,
                          double *out);

/* Gauss-Newton steps x (k), k <= 9, that pull lines onto steps near them: offset, strength (n, most), rows (n, k). A
 * step r away pulls with near = strength exp(-r^2 / (2 soft^2)), all of a sample together with near / (sum near +
 * nothing); held: added to the diagonal, as a share of it. Strengths of 0 or NaN are no steps.
 * stiff (k, k) holds before (k) + x near 0, in units of a sample's pull; null: nothing does. */
CC_API void cc_pull(int64_t n, int32_t most, int32_t k, const double *rows, const double *offset,
                    const double *strength, const double *stiff, const double *before, double soft, double nothing,
                    double held, int32_t pulls, double *x);

/* What share of the samples of each line meets a step of one sign: rising ones or falling ones, what is more. Of n
 * samples in `lines` runs, each from first[l] to the next, offset and slope (n, most <= CC_MOST_STEPS) say where steps
 * are, NaN for none; steps weaker than `faint` times one within `around` px do not count. moved (n, tries) px: by how
 * much the samples moved; a step within `on` px of that is met. scratch: 4 tries doubles. Writes share
 * (tries, lines). */
#define CC_MOST_STEPS 16
CC_API void cc_met(int64_t n, int32_t most, const double *offset, const double *slope, int64_t lines,
                   const int64_t *first, int64_t tries, const double *moved, double on, double faint, double around,
                   double *scratch, double *share);

#endif
