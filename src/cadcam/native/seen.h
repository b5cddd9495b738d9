/* Which points a rendered view shows, by its own depth and normals.
 *
 * depth (height, width) z in mm at pixel centres, infinite where there is nothing; normal (height, width, 3) unit normals
 * in the camera's axes; fx, fy the focal lengths in px. A point i, p (n, 3) mm in the camera's axes with z > 0 and q (n, 2)
 * its pixel, is seen if at one of the four pixel centres around it nothing is in front: the plane of the face there,
 * continued to the point's ray by at most `steepest` of its depth, lies no more than `slack` of the point's depth nearer.
 * Writes 1 for seen, 0 for hidden or outside the picture. */
#ifndef CADCAM_SEEN_H
#define CADCAM_SEEN_H

#include <stdint.h>

#include "raster.h"

CC_API void cc_seen(const float *depth, const float *normal, int32_t width, int32_t height, double fx, double fy,
                    double slack, double steepest, int64_t n, const double *p, const double *q, uint8_t *out);

/* The same for samples along lines, straight in the pixel plane of a camera without distortion: a, b (n, 2) the ends of
 * lines in the plane u = (x, y)/z, wa, wb (n) their 1/z; K (2, 3) takes u to pixels. Line i has samples[i] of them, in
 * the middles of as many equal shares. */
CC_API void cc_seen_lines(const float *depth, const float *normal, int32_t width, int32_t height, const double *K,
                          double slack, double steepest, int64_t n, const double *a, const double *b, const double *wa,
                          const double *wb, const int64_t *samples, uint8_t *out);

#endif
