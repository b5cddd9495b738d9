/* Patches: parts of a distorting camera's picture in which the lens is affine but for a little, and how little. Bends: the
 * same with the lens' curvature.
 *
 * The bounds are measured, not assumed: those of bends and of the smallest patches are the largest differences between
 * their map and the table's points, those of larger patches follow from their parts, whose maps differ from theirs most
 * at a corner. Whatever the table holds, the bounds are true; where there is no such map, they say nothing. */
#include <math.h>
#include <stdlib.h>

#include "internal.h"

#define ANYWHERE 1e300 /* a bound that says nothing, and gives 0 times 0 */

enum { EVERY = 3 }; /* the rows that maps are made from; their bounds are those of all */

typedef struct { double low, high; } range;
typedef struct { double sum; int32_t n; } mean;

static void grow(range *r, double low, double high) {
    if (!(low >= r->low)) r->low = isnan(low) ? -INFINITY : low;
    if (!(high <= r->high)) r->high = isnan(high) ? INFINITY : high;
}
static void add(mean *m, double value) { m->sum += value, m->n++; }
static double of(const mean *m) { return m->n ? m->sum / m->n : 0; }

static patch nowhere(double x, double y, int32_t seen) {
    const affine map = {.off_u = ANYWHERE, .off_v = ANYWHERE};
    return (patch){.map = map, .x = x, .y = y, .off_x = ANYWHERE, .off_y = ANYWHERE, .seen = seen};
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

/* A value of the table less its curvature about the middle. */
static double flat(double value, const double q[3], double i, double j) {
    return value - (q[0] * i * i + q[1] * i * j + q[2] * j * j);
}

static const double *point_at(const cc_lens *l, const double *points, int32_t x, int32_t y) {
    return points + 2 * ((size_t)y * (size_t)l->width + (size_t)x);
}
static int is_seen(const double *p) { return isfinite(p[0]) && isfinite(p[1]); }

/* What is left of the points of a rectangle after curvatures: the mean step from sample to sample, and what it leaves. */
static patch fitted(const cc_lens *l, const double *points, rect r, double x0, double y0, const double *u2,
                    const double *v2) {
    mean u = {0}, v = {0}, x = {0}, y = {0}, ux = {0}, uy = {0}, vx = {0}, vy = {0};
    for (int32_t j = r.y0; j <= r.y1; j += EVERY)
        for (int32_t i = r.x0; i <= r.x1; i++) {
            const double *p = point_at(l, points, i, j), dx = i - x0, dy = j - y0;
            if (!is_seen(p)) continue;
            const double *right = i < r.x1 ? p + 2 : p, *below = j < r.y1 ? point_at(l, points, i, j + 1) : p;
            const double pu = flat(p[0], u2, dx, dy), pv = flat(p[1], v2, dx, dy);
            add(&u, pu), add(&v, pv), add(&x, dx), add(&y, dy);
            if (right != p && is_seen(right))
                add(&ux, flat(right[0], u2, dx + 1, dy) - pu), add(&vx, flat(right[1], v2, dx + 1, dy) - pv);
            if (below != p && is_seen(below))
                add(&uy, flat(below[0], u2, dx, dy + 1) - pu), add(&vy, flat(below[1], v2, dx, dy + 1) - pv);
        }
    patch p = nowhere(x0, y0, 0);
    p.map.ux = of(&ux), p.map.uy = of(&uy), p.map.vx = of(&vx), p.map.vy = of(&vy);
    p.map.u = of(&u) - p.map.ux * of(&x) - p.map.uy * of(&y);
    p.map.v = of(&v) - p.map.vx * of(&x) - p.map.vy * of(&y);
    range in_u = {INFINITY, -INFINITY}, in_v = in_u;
    for (int32_t j = r.y0; j <= r.y1; j++)
        for (int32_t i = r.x0; i <= r.x1; i++) {
            const double *q = point_at(l, points, i, j), dx = i - x0, dy = j - y0;
            if (!is_seen(q)) continue;
            p.seen = 1;
            const double du = flat(q[0], u2, dx, dy) - (p.map.u + p.map.ux * dx + p.map.uy * dy);
            const double dv = flat(q[1], v2, dx, dy) - (p.map.v + p.map.vx * dx + p.map.vy * dy);
            grow(&in_u, du, du), grow(&in_v, dv, dv);
        }
    return p.seen ? completed(p, in_u, in_v, PATCH) : p;
}

/* The mean second differences of one coordinate, k = 0 or 1, of the points of a rectangle. */
static void curvature(const cc_lens *l, const double *points, rect r, int k, double out[3]) {
    mean xx = {0}, xy = {0}, yy = {0};
    for (int32_t j = r.y0; j < r.y1; j += EVERY)
        for (int32_t i = r.x0; i < r.x1; i++) {
            const double *p = point_at(l, points, i, j), *below = point_at(l, points, i, j + 1);
            const double *above = j > r.y0 ? point_at(l, points, i, j - 1) : NULL;
            if (!(isfinite(p[k]) && isfinite(p[k + 2]) && isfinite(below[k]) && isfinite(below[k + 2]))) continue;
            add(&xy, below[k + 2] - below[k] - p[k + 2] + p[k]);
            if (i > r.x0 && isfinite(p[k - 2])) add(&xx, p[k + 2] - 2 * p[k] + p[k - 2]);
            if (above && isfinite(above[k])) add(&yy, below[k] - 2 * p[k] + above[k]);
        }
    out[0] = 0.5 * of(&xx), out[1] = of(&xy), out[2] = 0.5 * of(&yy);
}

static bend bent(const cc_lens *l, const double *points, rect r) {
    bend b = {.x = r.x0, .y = r.y0};
    curvature(l, points, r, 0, b.u2), curvature(l, points, r, 1, b.v2);
    double size = 0;
    for (int k = 0; k < 3; k++) size += fabs(b.u2[k]) + fabs(b.v2[k]);
    for (int k = 0; k < 3 && !(size < 1e30); k++) b.u2[k] = b.v2[k] = 0;
    size = size < 1e30 ? size : 0;
    b.map = fitted(l, points, r, r.x0 + PATCH - 0.5, r.y0 + PATCH - 0.5, b.u2, b.v2).map;
    const affine *m = &b.map;
    const double off = (fabs(m->vx) + fabs(m->vy)) * m->off_u + (fabs(m->ux) + fabs(m->uy)) * m->off_v;
    b.rough = !(off < 2 * fabs(m->ux * m->vy - m->uy * m->vx)); /* 2 px */
    b.map.off_u += size * PATCH * PATCH * 0x1p-40, b.map.off_v += size * PATCH * PATCH * 0x1p-40;
    return b;
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

static rect square(const cc_lens *l, int32_t x, int32_t y, int32_t size) {
    const int32_t right = x + size - 1, bottom = y + size - 1;
    return (rect){x, right < l->width ? right : l->width - 1, y, bottom < l->height ? bottom : l->height - 1};
}

static patch of_square(const cc_lens *l, const double *points, int32_t x, int32_t y) {
    static const double none[3] = {0};
    const rect r = square(l, x, y, PATCH);
    return fitted(l, points, r, 0.5 * (r.x0 + r.x1), 0.5 * (r.y0 + r.y1), none, none);
}

int fill_patches(cc_lens *l, const double *points) {
    const int32_t nx = count_of(l->width, 0), ny = count_of(l->height, 0); /* of level 1 too */
    l->patches[0] = malloc((size_t)nx * (size_t)ny * sizeof(patch));
    l->bends = malloc((size_t)nx * (size_t)ny * sizeof(bend));
    if (!l->patches[0] || !l->bends) return 0;
    for (int32_t k = 0; k < nx * ny; k++) {
        const int32_t x = k % nx * PATCH, y = k / nx * PATCH;
        l->patches[0][k] = of_square(l, points, x, y);
        l->bends[k] = bent(l, points, square(l, x, y, 2 * PATCH));
    }
    for (int level = 1; level == 1 || step_of(level - 1) < l->width || step_of(level - 1) < l->height; level++)
        if (!fill_level(l, level)) return 0;
    return 1;
}

void free_patches(cc_lens *l) {
    free(l->bends);
    for (int k = 0; k < PATCH_LEVELS; k++) free(l->patches[k]);
}

const patch *patch_of(const cc_lens *l, const rect *r) {
    int level = 1;
    while (r->x1 - r->x0 >= step_of(level) || r->y1 - r->y0 >= step_of(level)) level++;
    const size_t i = (size_t)(r->x0 / step_of(level)), j = (size_t)(r->y0 / step_of(level));
    return &l->patches[level][j * (size_t)count_of(l->width, level) + i];
}

const bend *bend_at(const cc_lens *l, int32_t x, int32_t y) {
    return &l->bends[(size_t)(y / PATCH) * (size_t)count_of(l->width, 1) + (size_t)(x / PATCH)];
}
