/* Edges of a part slid over direction fields: see field.h. Compiled once for each instruction set. */
#include "eights.h"

#define FARTHEST_PX 1e6f /* a place farther beside the picture is not slid into it */
#define LANES 16 /* sums are added in groups of so many: a row of them is a multiple */

/* Add a plane, shifted by (x, y), to the window of sums, whose rows are `stride` long. */
static void add_shifted(const cc_field *f, int sector, int32_t x, int32_t y, int32_t wide, int32_t high, int32_t stride,
                        uint16_t *sums) {
    const uint8_t *plane = f->planes + (size_t)sector * (size_t)f->width * (size_t)f->height;
    const int32_t from_y = imax(0, -y), to_y = imin(high, f->height - y);
    if (x >= 0 && x + stride <= f->width) { /* the common case, a window inside: beyond `wide` nothing is looked at */
        const uint8_t *row = plane + (ptrdiff_t)(y + from_y) * f->width + x;
        uint16_t *out = sums + (size_t)from_y * (size_t)stride;
        for (int32_t j = from_y; j < to_y; j++, row += f->width, out += stride)
            for (int32_t k = 0; k < stride; k += LANES) *(h16 *)(out + k) += sixteen(row + k);
        return;
    }
    const int32_t from_x = imax(0, -x), to_x = imin(wide, f->width - x);
    if (from_x >= to_x) return;
    for (int32_t j = from_y; j < to_y; j++) {
        const uint8_t *row = plane + (ptrdiff_t)(y + j) * f->width + (x + from_x);
        uint16_t *restrict out = sums + (size_t)j * (size_t)stride + from_x;
        for (int32_t i = 0; i < to_x - from_x; i++) out[i] = (uint16_t)(out[i] + row[i]);
    }
}

/* The largest of the window's sums: its value, and where. */
static uint16_t largest(const uint16_t *sums, int32_t wide, int32_t high, int32_t stride, int32_t *x, int32_t *y) {
    uint16_t best = 0;
    *x = *y = 0;
    for (int32_t j = 0; j < high; j++) {
        const uint16_t *row = sums + (size_t)j * (size_t)stride;
        uint16_t top = 0;
        for (int32_t i = 0; i < wide; i++) top = row[i] > top ? row[i] : top;
        if (top <= best) continue;
        best = top, *y = j;
        for (*x = 0; row[*x] != top;) ++*x;
    }
    return best;
}

static void best_of(uint16_t *sums, int32_t wide, int32_t high, int32_t stride, int32_t keep, int32_t apart,
                    double mean, double deviation, int32_t left, int32_t top, int32_t *shift, float *score) {
    for (int32_t k = 0; k < keep; k++) {
        int32_t x, y;
        const uint16_t best = largest(sums, wide, high, stride, &x, &y);
        shift[2 * k] = left + x, shift[2 * k + 1] = top + y;
        score[k] = best ? (float)((best - mean) / deviation) : -INFINITY;
        if (k + 1 == keep) return;
        for (int32_t j = imax(0, y - apart); j <= imin(high - 1, y + apart); j++) {
            uint16_t *row = sums + (size_t)j * (size_t)stride;
            for (int32_t i = imax(0, x - apart); i <= imin(wide - 1, x + apart); i++) row[i] = 0;
        }
    }
}

void VARIANT(climb_slide)(const cc_pose_edges *v, int32_t eye, const double *poses, int32_t centre_x, int32_t centre_y,
                          int32_t reach_x, int32_t reach_y, int32_t keep, int32_t apart, uint16_t *scratch,
                          int32_t *shift, float *score) {
    const cc_eye *e = &v->eyes[eye];
    const int32_t stride = (2 * reach_x + LANES) / LANES * LANES;
    const int32_t wide = 2 * reach_x + 1, high = 2 * reach_y + 1, left = centre_x - reach_x, top = centre_y - reach_y;
    for (int64_t k = 0; k < v->n_poses; k++) {
        const run all = run_of(v, k, eye);
        const int32_t count = imin(all.count, CC_SLIDABLE);
        double mean = 0, variance = 1e-9;
        memset(scratch, 0, (size_t)stride * (size_t)high * sizeof *scratch);
        const view w = count ? view_of(e, poses + 12 * k, all.places->p) : (view){0};
        for (int32_t i = 0; i < count; i += 8) {
            const eight_places some = eight_of(all.places + i, count - i, all.places->p);
            const eight_spots s = images_of(&w, &some, FARTHEST_PX);
            const i8 x = nearest_to(s.x) + left, y = nearest_to(s.y) + top;
            for (int m = 0; m < 8; m++) {
                if (!s.there[m]) continue;
                add_shifted(&e->field, s.sector[m], x[m], y[m], wide, high, stride, scratch);
                mean += e->field.mean[s.sector[m]], variance += e->field.variance[s.sector[m]];
            }
        }
        best_of(scratch, wide, high, stride, keep, apart, mean, sqrt(variance), left, top, shift + 2 * keep * k,
                score + keep * k);
    }
}
