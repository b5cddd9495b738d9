/* Masks of a rendered view in the form that label files hold. Plain C11 like raster.h. */
#ifndef CADCAM_LAYERS_H
#define CADCAM_LAYERS_H

#include <stdint.h>

#include "raster.h"

/* A mask (height, width) of zeros and ones: how many are set, and the first and last column and row that hold one,
 * found = {count, x0, y0, x1, y1}; -1 for all four where none does. */
CC_API void cc_mask_region(const uint8_t *mask, int32_t width, int32_t height, int64_t found[5]);
/* Column by column, as COCO counts: the places x * height + y where it differs from the one before, and before the
 * first from 0. `first` holds width + 1 numbers. Returns how many there are; writes as many as there is room for. */
CC_API int64_t cc_mask_changes(const uint8_t *mask, int32_t width, int32_t height, int64_t *first, int64_t room,
                               int64_t *at);

#endif
