/* The picture of a mark as a function of its geometry, with derivatives: the model that is fitted to grey values.
 *
 * A pixel's place on the mark is p = N_xy / N_z, N = H (m, 1): H (3, 3) is the plane's homography (mark from image),
 * m the pixel's coordinates, those of the picture or, through a lens, of its tangent plane. The mark is ink within
 * sectors of rings, blurred by a Gaussian of s px.
 */
#ifndef CADCAM_MARK_H
#define CADCAM_MARK_H

#include <stdint.h>

#include "raster.h"

/* sectors (n, 4): inner and outer, which of the radii (-1: none); start and stop, which of the rays (-1: a whole ring).
 * span (n): from start to stop, rad. Angles go from x towards y. */
typedef struct {
    const double *radii, *rays; /* mm; (cos, sin) */
    const int32_t *sectors;
    const double *span;
    int32_t n_radii, n_sectors;
} cc_mark;

/* Grey values (marks, pixels) of
 *     I = (m + c (share(q) + b share(q) (1 - share(q)))) (1 + gx u + gy v)
 * and, unless slopes is null, their slopes (marks, pixels, terms + 5 + loose) by x y * * c s m gx gy, the rest of the
 * geometry and the first `loose` (0 to 3) of b dx dy, where dH (marks, terms, 3, 3) are the slopes of H by the
 * geometry's parameters, at least 4. levels (marks, 8): c s m gx gy b dx dy. share is the mean over the mark's motion
 * while the shutter is open, q - t d for t in [-1/2, 1/2]. places (marks, pixels, width): u, v and, where width is 8, m
 * and dm/dq (2, 2); else m is (u, v). weight (marks, pixels), unless null: pixels of weight 0 are not computed; value
 * and slopes are 0 there.
 *
 * The share of ink in a disc is exact for the conic that a circle is in the picture: along the normal of its border by
 * the normal distribution, across it by Gauss and Hermite's rule, with more nodes the more the border bends within s.
 * A straight border through the centre is exact too, and so is the corner where two straight borders meet at any angle
 * (the bivariate normal distribution); where a ray meets a circle the circle is taken as straight in what the corner
 * adds. */
enum { CC_MARK_RADII = 128, CC_MARK_TERMS = 16 };
CC_API void cc_mark_picture(const cc_mark *mark, int64_t marks, int64_t pixels, int32_t width, const double *places,
                            const double *weight, const double *H, int32_t terms, const double *dH,
                            const double *levels, int32_t loose, double *value, double *slopes);

#endif
