/* Pictures packed row by row as the rows are produced, without a picture of bytes in memory. */
#ifndef CADCAM_ROWS_H
#define CADCAM_ROWS_H

#include <stdint.h>

/* Put row y of a picture into `row`; return 0 where it is all zeros. Rows are asked for once each, from the top. */
typedef int (*next_row)(const void *picture, int64_t y, uint8_t *row);

/* As cc_pack in pack.h. */
int64_t pack_rows(next_row next, const void *picture, int64_t row_bytes, int64_t rows, int32_t pixel_bytes,
                  uint8_t *out, int64_t room);

#endif
