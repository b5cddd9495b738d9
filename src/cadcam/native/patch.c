/* Patches: parts of a distorting camera's picture in which the lens is affine but for a little, and how little.
 *
 * The bound is measured, not assumed: that of the smallest patches is the largest difference between their affine map
 * and the table's points, that of larger ones follows from their parts, whose maps differ from theirs most at a corner.
 * Whatever the table holds, the bounds are true; where there is no affine map to speak of, they say nothing. */
#include <math.h>
#include <stdlib.h>

#include "internal.h"

#define ANYWHERE 1e300 /* a bound that says nothing, and gives 0 times 0 */

typedef struct { double low, high; } range;
typedef struct { double sum; int32_t n; } mean;

static void grow(range *r, double low, double high) {
    if (!(low >= r->low)) r->low = isnan(low) ? -INFINITY : low;
    if (!(high <= r->high)) r->high = isnan(high) ? INFINITY : high;
}
static void add(mean *m, double value) { m->sum += value, m->n++; }
static double of(const mean *m) { return m->n ? m->sum / m->n : 0; }

static patch nowhere(double x, double y, int32_t seen) {
    return (patch){.map = {.off_u = ANYWHERE, .off_v = ANYWHERE}, .x = x, .y = y, .off_x = ANYWHERE, .off_y = ANYWHERE,
                   .seen = seen};
}

/* Complete a patch whose plane points lie in (u, v) + J (i, j) + (in_u, in_v): centre the bounds, turn the map round. */
static patch completed(patch p, range in_u, range in_v, double half) {
    const double slack = 0x1p-40; /* far above the rounding of what is computed with it */
    p.map.u += 0.5 * (in_u.low + in_u.high), p.map.v += 0.5 * (in_v.low + in_v.high);
    p.map.off_u = 0.5 * (in_u.high - in_u.low) + slack * (fabs(p.map.u) + (fabs(p.map.ux) + fabs(p.map.uy)) * half);
    p.map.off_v = 0.5 * (in_v.high - in_v.low) + slack * (fabs(p.map.v) + (fabs(p.map.vx) + fabs(p.map.vy)) * half);
    double main = p.map.ux * p.map.vy, side = p.map.uy * p.map.vx, det = main - side;
    p.xu = p.map.vy / det, p.xv = -p.map.uy / det, p.yu = -p.map.vx / det, p.yv = p.map.ux / det;
    p.off_x = fabs(p.xu) * p.map.off_u + fabs(p.xv) * p.map.off_v, p.off_y = fabs(p.yu) * p.map.off_u + fabs(p.yv) * p.map.off_v;
    /* nearly singular maps are not turned round accurately; what overflows is no use */
    int fit = fabs(det) >= 0x1p-10 * (fabs(main) + fabs(side)) && det != 0 && p.off_x < 1e9 && p.off_y < 1e9 &&
              fabs(p.xu) + fabs(p.xv) + fabs(p.yu) + fabs(p.yv) < 1e30 && p.map.off_u < 1e30 && p.map.off_v < 1e30;
    return fit ? p : nowhere(p.x, p.y, 1);
}

/* From the points of a rectangle: the mean step from sample to sample, and what it leaves. */
static patch fitted(const double *points, int32_t width, rect r) {
    mean u = {0}, v = {0}, x = {0}, y = {0}, ux = {0}, uy = {0}, vx = {0}, vy = {0};
    for (int32_t j = r.y0; j <= r.y1; j++)
        for (int32_t i = r.x0; i <= r.x1; i++) {
            const double *p = points + 2 * ((size_t)j * (size_t)width + (size_t)i);
            const double *right = p + 2 * (i < r.x1), *below = p + 2 * (size_t)width * (j < r.y1);
            if (!(isfinite(p[0]) && isfinite(p[1]))) continue;
            add(&u, p[0]), add(&v, p[1]), add(&x, i), add(&y, j);
            if (i < r.x1 && isfinite(right[0]) && isfinite(right[1])) add(&ux, right[0] - p[0]), add(&vx, right[1] - p[1]);
            if (j < r.y1 && isfinite(below[0]) && isfinite(below[1])) add(&uy, below[0] - p[0]), add(&vy, below[1] - p[1]);
        }
    patch p = nowhere(0.5 * (r.x0 + r.x1), 0.5 * (r.y0 + r.y1), u.n > 0);
    if (!p.seen) return p;
    p.map.ux = of(&ux), p.map.uy = of(&uy), p.map.vx = of(&vx), p.map.vy = of(&vy);
    p.map.u = of(&u) - p.map.ux * (of(&x) - p.x) - p.map.uy * (of(&y) - p.y);
    p.map.v = of(&v) - p.map.vx * (of(&x) - p.x) - p.map.vy * (of(&y) - p.y);
    range in_u = {INFINITY, -INFINITY}, in_v = in_u;
    for (int32_t j = r.y0; j <= r.y1; j++)
        for (int32_t i = r.x0; i <= r.x1; i++) {
            const double *q = points + 2 * ((size_t)j * (size_t)width + (size_t)i), dx = i - p.x, dy = j - p.y;
            if (!(isfinite(q[0]) && isfinite(q[1]))) continue;
            const double du = q[0] - (p.map.u + p.map.ux * dx + p.map.uy * dy), dv = q[1] - (p.map.v + p.map.vx * dx + p.map.vy * dy);
            grow(&in_u, du, du), grow(&in_v, dv, dv);
        }
    return completed(p, in_u, in_v, PATCH);
}

/* From up to four parts of `half` samples to either side of their middles. */
static patch joined(const patch *const part[], int n, double x, double y, double half) {
    mean u = {0}, v = {0}, ux = {0}, uy = {0}, vx = {0}, vy = {0};
    patch p = nowhere(x, y, 0);
    for (int k = 0; k < n; k++) {
        const patch *q = part[k];
        if (!q->seen) continue;
        add(&ux, q->map.ux), add(&uy, q->map.uy), add(&vx, q->map.vx), add(&vy, q->map.vy), p.seen = 1;
    }
    p.map.ux = of(&ux), p.map.uy = of(&uy), p.map.vx = of(&vx), p.map.vy = of(&vy);
    for (int k = 0; k < n; k++) {
        const double i = part[k]->x - x, j = part[k]->y - y;
        if (!part[k]->seen) continue;
        add(&u, part[k]->map.u - (p.map.ux * i + p.map.uy * j)), add(&v, part[k]->map.v - (p.map.vx * i + p.map.vy * j));
    }
    p.map.u = of(&u), p.map.v = of(&v);
    range in_u = {INFINITY, -INFINITY}, in_v = in_u;
    for (int k = 0; k < n; k++) {
        const patch *q = part[k];
        const double i = q->x - x, j = q->y - y;
        if (!q->seen) continue;
        const double du = q->map.u - (p.map.u + p.map.ux * i + p.map.uy * j), dv = q->map.v - (p.map.v + p.map.vx * i + p.map.vy * j);
        const double wide_u = q->map.off_u + (fabs(q->map.ux - p.map.ux) + fabs(q->map.uy - p.map.uy)) * half;
        const double wide_v = q->map.off_v + (fabs(q->map.vx - p.map.vx) + fabs(q->map.vy - p.map.vy)) * half;
        grow(&in_u, du - wide_u, du + wide_u), grow(&in_v, dv - wide_v, dv + wide_v);
    }
    return p.seen ? completed(p, in_u, in_v, 2 * half) : p;
}

/* Patches of level 0 lie side by side; those above overlap by half, so that one holds any rectangle of half its size. */
static int32_t step_of(int level) { return level ? PATCH / 2 << level : PATCH; }
static int32_t count_of(int32_t samples, int level) { return (samples + step_of(level) - 1) / step_of(level); }

static int fill_level(cc_lens *l, int level) {
    const int32_t nx = count_of(l->width, level), ny = count_of(l->height, level), size = PATCH << level;
    const int32_t below_x = count_of(l->width, level - 1), below_y = count_of(l->height, level - 1), next = level > 1 ? 2 : 1;
    l->patches[level] = malloc((size_t)nx * (size_t)ny * sizeof(patch));
    if (!l->patches[level]) return 0;
    for (int32_t j = 0; j < ny; j++)
        for (int32_t i = 0; i < nx; i++) {
            const patch *part[4];
            int n = 0;
            for (int32_t y = j * next; y <= j * next + next && y < below_y; y += next)
                for (int32_t x = i * next; x <= i * next + next && x < below_x; x += next)
                    part[n++] = &l->patches[level - 1][(size_t)y * (size_t)below_x + (size_t)x];
            const double middle = 0.5 * (size - 1);
            l->patches[level][(size_t)j * (size_t)nx + (size_t)i] =
                joined(part, n, i * step_of(level) + middle, j * step_of(level) + middle, 0.25 * size);
        }
    return 1;
}

static rect square(const cc_lens *l, int32_t i, int32_t j, int32_t size) {
    const int32_t x = i * size, y = j * size, right = x + size - 1, bottom = y + size - 1;
    return (rect){x, right < l->width ? right : l->width - 1, y, bottom < l->height ? bottom : l->height - 1};
}

int fill_patches(cc_lens *l, const double *points) {
    for (int32_t t = 0; t < l->tiles_x * l->tiles_y; t++)
        l->tile[t] = fitted(points, l->width, square(l, t % l->tiles_x, t / l->tiles_x, TILE)).map;
    const int32_t nx = count_of(l->width, 0), ny = count_of(l->height, 0);
    l->patches[0] = malloc((size_t)nx * (size_t)ny * sizeof(patch));
    if (!l->patches[0]) return 0;
    for (int32_t j = 0; j < ny; j++)
        for (int32_t i = 0; i < nx; i++)
            l->patches[0][(size_t)j * (size_t)nx + (size_t)i] = fitted(points, l->width, square(l, i, j, PATCH));
    for (int level = 1; level == 1 || step_of(level - 1) < l->width || step_of(level - 1) < l->height; level++)
        if (!fill_level(l, level)) return 0;
    return 1;
}

void free_patches(cc_lens *l) {
    for (int k = 0; k < PATCH_LEVELS; k++) free(l->patches[k]);
}

const patch *patch_of(const cc_lens *l, const rect *r) {
    int level = 1;
    while (r->x1 - r->x0 >= step_of(level) || r->y1 - r->y0 >= step_of(level)) level++;
    const size_t i = (size_t)(r->x0 / step_of(level)), j = (size_t)(r->y0 / step_of(level));
    return &l->patches[level][j * (size_t)count_of(l->width, level) + i];
}

const patch *block_patch(const cc_lens *l, int level, int32_t bx, int32_t by) {
    const int k = level - 2; /* patches of level 0 are 4 x 4 tiles */
    return &l->patches[k][(size_t)(2 * by) * (size_t)count_of(l->width, k) + (size_t)(2 * bx)];
}
