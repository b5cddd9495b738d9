/* The picture data of a PNG file, quickly: the compressor finds what rendered pictures have, flat faces on an even
 * background, and no more. Plain C11 like raster.h. */
#ifndef CADCAM_PACK_H
#define CADCAM_PACK_H

#include <stdint.h>

#include "raster.h"

/* Rows (rows, row_bytes) of pixels of pixel_bytes each, in PNG's order of bytes, filtered (each row as its difference
 * to the one above; PNG specification, 9.2) and packed as a zlib stream (RFC 1950 and 1951). Returns how many bytes
 * were written to `out`, or -1 where memory is short or there is no room for them: cc_pack_room is enough. */
CC_API int64_t cc_pack(const uint8_t *pixels, int64_t row_bytes, int64_t rows, int32_t pixel_bytes, uint8_t *out,
                       int64_t room);
/* The same of layers (height, width) of a view, at pixel centres, depth infinite where there is nothing: zeros there.
 * Depth by `step`, rounded, at most 65535, 16 bits; unit normals (height, width, 3) as (c + 1)/2 in steps of 1/255. */
CC_API int64_t cc_pack_depth(const float *depth, int32_t width, int32_t height, float step, uint8_t *out, int64_t room);
CC_API int64_t cc_pack_normals(const float *depth, const float *normal, int32_t width, int32_t height, uint8_t *out,
                               int64_t room);
CC_API int64_t cc_pack_room(int64_t row_bytes, int64_t rows);

#endif
