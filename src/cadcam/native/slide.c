/* Edges of a part slid over direction fields: see field.h. Compiled once for each instruction set. */
#include "eights.h"

#define FARTHEST_PX 1e6f /* a place farther beside the picture is not slid into it */
#define LANES 16 /* sums are added in groups of so many: a row of them is a multiple */
static const uint16_t STEPS[LANES] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};

/* A window of shifts in the field, and its sums, whose rows are `stride` long: beyond `wide` nothing is looked at. */
typedef struct {
    const cc_field *field;
    uint16_t *sums;
    int32_t wide, high, stride;
} window;

static inline const uint8_t *sector_plane(const cc_field *f, int sector) {
    return f->planes + (size_t)sector * (size_t)f->width * (size_t)f->height;
}

/* Where in a plane shifted by (x, y) the window begins, if all of its rows lie in the picture, else NULL. */
static inline const uint8_t *inside_at(const window *w, int sector, int32_t x, int32_t y) {
    const cc_field *f = w->field;
    if ((x < 0) | (y < 0) | (x + w->stride > f->width) | (y + w->high > f->height)) return NULL;
    return sector_plane(f, sector) + (ptrdiff_t)y * f->width + x;
}

/* Add windows that begin at n places of the planes. */
static void add_whole(const window *w, const uint8_t *const *from, int n) {
    for (int32_t j = 0; j < w->high; j++)
        for (int32_t k = 0; k < w->stride; k += LANES) {
            h16 *out = (h16 *)(w->sums + (ptrdiff_t)j * w->stride + k), sum = *out;
            for (int i = 0; i < n; i++) sum += sixteen(from[i] + (ptrdiff_t)j * w->field->width + k);
            *out = sum;
        }
}

/* Add to `out` those of LANES numbers of a row, shifted by x, that lie in it; none beyond `first` .. `last` is read. */
INLINE void add_some(const uint8_t *row, int32_t x, int32_t width, const uint8_t *first, const uint8_t *last,
                     uint16_t *out) {
    const int32_t from = imax(0, -x), to = imin(LANES, width - x);
    const ptrdiff_t begin = row - first + x;
    if (begin >= 0 && begin + LANES <= last - first + 1) {
        const h16 lane = *(const h16 *)STEPS;
        *(h16 *)out += sixteen(first + begin) & (lane >= (uint16_t)from) & (lane < (uint16_t)imax(to, 0));
        return;
    }
    for (int32_t i = from; i < to; i++) out[i] = (uint16_t)(out[i] + row[x + i]);
}

/* Add a plane, shifted by (x, y), as far as it reaches. */
static void add_part(const window *w, int sector, int32_t x, int32_t y) {
    const cc_field *f = w->field;
    const uint8_t *first = f->planes, *last = sector_plane(f, CC_SECTORS) - 1, *plane = sector_plane(f, sector);
    if (x <= -w->stride || x >= f->width) return;
    for (int32_t j = imax(0, -y); j < imin(w->high, f->height - y); j++)
        for (int32_t k = 0; k < w->stride; k += LANES)
            add_some(plane + (ptrdiff_t)(y + j) * f->width, x + k, f->width, first, last,
                     w->sums + (ptrdiff_t)j * w->stride + k);
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
    const window shifts = {&e->field, scratch, wide, high, stride};
    const uint8_t *inside[CC_SLIDABLE];
    for (int64_t k = 0; k < v->n_poses; k++) {
        const run all = run_of(v, k, eye);
        int n = 0;
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
                const uint8_t *from = inside_at(&shifts, s.sector[m], x[m], y[m]);
                if (from) inside[n++] = from;
                else add_part(&shifts, s.sector[m], x[m], y[m]);
                mean += e->field.mean[s.sector[m]], variance += e->field.variance[s.sector[m]];
            }
        }
        add_whole(&shifts, inside, n);
        best_of(scratch, wide, high, stride, keep, apart, mean, sqrt(variance), left, top, shift + 2 * keep * k,
                score + keep * k);
    }
}
