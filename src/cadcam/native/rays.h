/* The first triangle that a ray meets, in double, by a tree of boxes.
 *
 * Plain C11 like raster.h. */
#ifndef CADCAM_RAYS_H
#define CADCAM_RAYS_H

#include <stdint.h>

#include "raster.h"

typedef struct cc_rays cc_rays;

/* Triangles, copied: vertices (V, 3), faces (n, 3) indices into them. NULL without memory. */
CC_API cc_rays *cc_rays_new(const double *vertices, const int32_t *faces, int64_t n);
CC_API void cc_rays_free(cc_rays *rays);

/* For rays (m) from origin (m, 3) along direction (m, 3), up to reach (m) times that: the face (m) met first, one of
 * those met at the same place, -1 for none. Edges count as both their faces, so that a closed surface has no gap.
 * Threads may call it at the same time. */
CC_API void cc_rays_first(const cc_rays *rays, int64_t m, const double *origin, const double *direction,
                          const double *reach, int32_t *face);

#endif
