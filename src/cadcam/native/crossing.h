/* Where segments cross in a plane, exact, by a grid.
 *
 * Plain C11 like raster.h; every function writes its answers into memory of the caller. */
#ifndef CADCAM_CROSSING_H
#define CADCAM_CROSSING_H

#include <stdint.h>

#include "raster.h"

/* Segments in the plane u = (x, y)/z: ends a, b (n, 2) and inverse depths wa, wb (n) there, w linear between them. */
typedef struct {
    const double *a, *b, *wa, *wb;
    int64_t n;
} cc_flat;

/* The crossings of lines with borders that are not behind them there: which line, and the fraction s of its image.
 * slack (borders->n) lengthens each border at both ends by that distance in u. Parallel segments do not cross; a
 * crossing may come more than once. Returns how many there are, -1 without memory; writes as many as fit. */
CC_API int64_t cc_crossings(const cc_flat *lines, const cc_flat *borders, const double *slack, int64_t room,
                            int64_t *line, double *s);

#endif
