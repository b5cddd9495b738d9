/* Patches: parts of a distorting camera's picture in which the lens is nearly affine, with bounds of the error. Bends:
 * the same with the lens' curvature.
 *
 * The bounds are measured, not assumed: those of bends and of the smallest patches are the largest differences between
 * their map and the table's points, those of larger patches follow from their parts, whose maps differ from theirs most
 * at a corner. Whatever the table holds, the bounds are true; where there is no such map, they say nothing. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"

#define ANYWHERE 1e300 /* no bound, but finite, so that 0 times it is 0 */

#define STRONG 3.0 /* px */

/* Every so many rows and columns maps are made from; their bounds are those of all. No multiple of the usual numbers of
 * samples along a pixel: a table is straight within pixels, and bent between them. */
enum { EVERY = 5 };

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

/* Complete a patch whose plane points lie in (u, v) + J (i, j) + (in_u, in_v): centre its bounds, invert the map. */
static patch completed(patch p, range in_u, range in_v, double half) {
    const double slack = 0x1p-40; /* far above the rounding of what is computed with it */
    p.map.u += 0.5 * (in_u.low + in_u.high), p.map.v += 0.5 * (in_v.low + in_v.high);
    p.map.off_u = 0.5 * (in_u.high - in_u.low) + slack * (fabs(p.map.u) + (fabs(p.map.ux) + fabs(p.map.uy)) * half);
    p.map.off_v = 0.5 * (in_v.high - in_v.low) + slack * (fabs(p.map.v) + (fabs(p.map.vx) + fabs(p.map.vy)) * half);
    double main = p.map.ux * p.map.vy, side = p.map.uy * p.map.vx, det = main - side;
    p.xu = p.map.vy / det, p.xv = -p.map.uy / det, p.yu = -p.map.vx / det, p.yv = p.map.ux / det;
    p.off_x = fabs(p.xu) * p.map.off_u + fabs(p.xv) * p.map.off_v;
    p.off_y = fabs(p.yu) * p.map.off_u + fabs(p.yv) * p.map.off_v;
    /* nearly singular maps are not inverted accurately, and may overflow */
    int fit = fabs(det) >= 0x1p-10 * (fabs(main) + fabs(side)) && det != 0 && p.off_x < 1e9 && p.off_y < 1e9 &&
              fabs(p.xu) + fabs(p.xv) + fabs(p.yu) + fabs(p.yv) < 1e30 && p.map.off_u < 1e30 && p.map.off_v < 1e30;
    return fit ? p : nowhere(p.x, p.y, 1);
}

/* A value of the table less that. */
static double flat(double value, const curves *c, double i, double j) {
    const double *q = c->q, *t = c->t;
    return value - (i * (i * (q[0] + t[0] * i + t[1] * j) + j * (q[1] + t[2] * j)) + j * j * (q[2] + t[3] * j));
}

static const curves NO_CURVES = {{0}, {0}};

static const double *point_at(const cc_lens *l, const double *points, int32_t x, int32_t y) {
    return points + 2 * ((size_t)y * (size_t)l->width + (size_t)x);
}
static int is_seen(const double *p) { return isfinite(p[0]) && isfinite(p[1]); }

/* What is left of the points of a rectangle after curvatures: the mean step between samples, and what that leaves. */
static patch fitted(const cc_lens *l, const double *points, rect r, double x0, double y0, const curves *u2,
                    const curves *v2) {
    mean u = {0}, v = {0}, x = {0}, y = {0}, ux = {0}, uy = {0}, vx = {0}, vy = {0};
    for (int32_t j = r.y0; j <= r.y1; j += EVERY)
        for (int32_t i = r.x0; i <= r.x1; i += EVERY) {
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
    const affine *m = &p.map;
    const double size = fabs(m->u) + fabs(m->v) + fabs(m->ux) + fabs(m->uy) + fabs(m->vx) + fabs(m->vy);
    if (!(size < 1e30)) return nowhere(x0, y0, 1);
    const int bent = u2 != &NO_CURVES;
    const range in_u = IN_USE(left_by)(l, &r, 0, &(expansion){x0, y0, {m->u, m->ux, m->uy}, *u2, bent});
    const range in_v = IN_USE(left_by)(l, &r, 1, &(expansion){x0, y0, {m->v, m->vx, m->vy}, *v2, bent});
    p.seen = in_u.low <= in_u.high;
    return p.seen ? completed(p, in_u, in_v, PATCH) : p;
}

/* A mean of differences, and of where they were taken, from the middle. */
typedef struct { mean value, i, j; } difference;

static void take(difference *d, double value, double i, double j) {
    if (isfinite(value)) add(&d->value, value), add(&d->i, i), add(&d->j, j);
}

/* The mean third differences of one coordinate, k = 0 or 1, of the points of a rectangle, and the mean second
 * differences less what the third make of them. */
static curves curvature(const cc_lens *l, const double *points, rect r, int k, double x0, double y0) {
    difference xx = {0}, xy = {0}, yy = {0};
    mean third[4] = {{0}};
    const ptrdiff_t row = 2 * (ptrdiff_t)l->width;
    for (int32_t y = r.y0 + 1; y < r.y1; y += EVERY)
        for (int32_t x = r.x0 + 1; x < r.x1; x += EVERY) {
            const double *p = point_at(l, points, x, y) + k, i = x - x0, j = y - y0;
            const double dxx = p[2] - 2 * p[0] + p[-2], dyy = p[row] - 2 * p[0] + p[-row];
            const double dxy = 0.25 * (p[row + 2] - p[row - 2] - p[2 - row] + p[-row - 2]);
            const double dxx_after = p[row + 2] - 2 * p[row] + p[row - 2];
            const double dxx_before = p[2 - row] - 2 * p[-row] + p[-row - 2];
            const double dxxy = 0.5 * (dxx_after - dxx_before);
            const double dxyy = 0.5 * ((p[row + 2] - 2 * p[2] + p[2 - row]) - (p[row - 2] - 2 * p[-2] + p[-row - 2]));
            take(&xx, dxx, i, j), take(&xy, dxy, i, j), take(&yy, dyy, i, j);
            if (isfinite(dxxy)) add(&third[1], dxxy);
            if (isfinite(dxyy)) add(&third[2], dxyy);
            const double dxxx = x + 2 <= r.x1 ? p[4] - 3 * p[2] + 3 * p[0] - p[-2] : NAN;
            const double dyyy = y + 2 <= r.y1 ? p[2 * row] - 3 * p[row] + 3 * p[0] - p[-row] : NAN;
            if (isfinite(dxxx)) add(&third[0], dxxx);
            if (isfinite(dyyy)) add(&third[3], dyyy);
        }
    curves c = {.t = {of(&third[0]) / 6, of(&third[1]) / 2, of(&third[2]) / 2, of(&third[3]) / 6}};
    c.q[0] = 0.5 * of(&xx.value) - 3 * c.t[0] * of(&xx.i) - c.t[1] * of(&xx.j);
    c.q[1] = of(&xy.value) - 2 * c.t[1] * of(&xy.i) - 2 * c.t[2] * of(&xy.j);
    c.q[2] = 0.5 * of(&yy.value) - c.t[2] * of(&yy.i) - 3 * c.t[3] * of(&yy.j);
    return c;
}

/* The largest value of that within `half` samples of the middle. */
static double reach_of(const curves *c, double half) {
    double square = 0, cube = 0;
    for (int k = 0; k < 3; k++) square += fabs(c->q[k]);
    for (int k = 0; k < 4; k++) cube += fabs(c->t[k]);
    return half * half * (square + half * cube);
}

static bend bent(const cc_lens *l, const double *points, rect r, int32_t half) {
    const double x0 = r.x0 + half - 0.5, y0 = r.y0 + half - 0.5;
    curves u = curvature(l, points, r, 0, x0, y0), v = curvature(l, points, r, 1, x0, y0);
    if (!(reach_of(&u, half) + reach_of(&v, half) < 1e30)) u = v = (curves){0};
    const double most_u = reach_of(&u, half), most_v = reach_of(&v, half);
    bend b = {.map = fitted(l, points, r, x0, y0, &u, &v).map, .x = r.x0, .y = r.y0, .half = half};
    memcpy(b.u2, u.q, sizeof b.u2), memcpy(b.v2, v.q, sizeof b.v2);
    memcpy(b.u3, u.t, sizeof b.u3), memcpy(b.v3, v.t, sizeof b.v3);
    const affine *m = &b.map;
    const double det = fabs(m->ux * m->vy - m->uy * m->vx);
    const double of_u = fabs(m->vx) + fabs(m->vy), of_v = fabs(m->ux) + fabs(m->uy);
    b.rough = !(of_u * m->off_u + of_v * m->off_v < 2 * det); /* 2 px */
    b.strong = !(of_u * most_u + of_v * most_v < STRONG * det);
    b.map.off_u += most_u * 0x1p-40, b.map.off_v += most_v * 0x1p-40;
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
        add(&u, part[k]->map.u - (p.map.ux * i + p.map.uy * j));
        add(&v, part[k]->map.v - (p.map.vx * i + p.map.vy * j));
    }
    p.map.u = of(&u), p.map.v = of(&v);
    range in_u = {INFINITY, -INFINITY}, in_v = in_u;
    for (int k = 0; k < n; k++) {
        const patch *q = part[k];
        const double i = q->x - x, j = q->y - y;
        if (!q->seen) continue;
        const double du = q->map.u - (p.map.u + p.map.ux * i + p.map.uy * j);
        const double dv = q->map.v - (p.map.v + p.map.vx * i + p.map.vy * j);
        const double wide_u = q->map.off_u + (fabs(q->map.ux - p.map.ux) + fabs(q->map.uy - p.map.uy)) * half;
        const double wide_v = q->map.off_v + (fabs(q->map.vx - p.map.vx) + fabs(q->map.vy - p.map.vy)) * half;
        grow(&in_u, du - wide_u, du + wide_u), grow(&in_v, dv - wide_v, dv + wide_v);
    }
    return p.seen ? completed(p, in_u, in_v, 2 * half) : p;
}

/* Patches of level 0 overlap by half; those above by three quarters, so that one holds any rectangle of that share. */
static int32_t step_of(int level) { return level ? PATCH / 4 << level : PATCH / 2; }
static int32_t count_of(int32_t samples, int level) { return (samples + step_of(level) - 1) / step_of(level); }

static int fill_level(cc_lens *l, int level) {
    const int32_t nx = count_of(l->width, level), ny = count_of(l->height, level), size = PATCH << level;
    const int32_t below_x = count_of(l->width, level - 1), below_y = count_of(l->height, level - 1);
    const int32_t next = level > 1 ? 2 : 1;
    l->patches[level] = malloc((size_t)nx * (size_t)ny * sizeof(patch));
    if (!l->patches[level]) return 0;
    for (int32_t j = 0; j < ny; j++)
        for (int32_t i = 0; i < nx; i++) {
            const patch *part[4];
            int n = 0;
            for (int32_t y = j * next; y <= (j + 2) * next && y < below_y; y += 2 * next)
                for (int32_t x = i * next; x <= (i + 2) * next && x < below_x; x += 2 * next)
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
    const rect r = square(l, x, y, PATCH);
    return fitted(l, points, r, 0.5 * (r.x0 + r.x1), 0.5 * (r.y0 + r.y1), &NO_CURVES, &NO_CURVES);
}

static int fill_bends(cc_lens *l, const double *points, int level) {
    const int32_t half = PATCH / 2 << level, nx = (l->width + half - 1) / half, ny = (l->height + half - 1) / half;
    l->bends[level] = malloc((size_t)nx * (size_t)ny * sizeof(bend));
    if (!l->bends[level]) return 0;
    for (int32_t k = 0; k < nx * ny; k++)
        l->bends[level][k] = bent(l, points, square(l, k % nx * half, k / nx * half, 2 * half), half);
    return 1;
}

int fill_patches(cc_lens *l, const double *points) {
    const int32_t nx = count_of(l->width, 0), ny = count_of(l->height, 0);
    l->patches[0] = malloc((size_t)nx * (size_t)ny * sizeof(patch));
    if (!l->patches[0]) return 0;
    for (int32_t k = 0; k < nx * ny; k++)
        l->patches[0][k] = of_square(l, points, k % nx * step_of(0), k / nx * step_of(0));
    for (int level = 1; level == 1 || 3 * step_of(level - 1) < l->width || 3 * step_of(level - 1) < l->height; level++)
        if (!fill_level(l, level)) return 0;
    return fill_bends(l, points, 0) && fill_bends(l, points, 1);
}

void free_patches(cc_lens *l) {
    for (int k = 0; k < BEND_LEVELS; k++) free(l->bends[k]);
    for (int k = 0; k < PATCH_LEVELS; k++) free(l->patches[k]);
}

const patch *patch_of(const cc_lens *l, const rect *r) {
    int level = r->x1 - r->x0 > PATCH / 2 || r->y1 - r->y0 > PATCH / 2;
    while (level && (r->x1 - r->x0 > 3 * step_of(level) || r->y1 - r->y0 > 3 * step_of(level))) level++;
    const size_t i = (size_t)(r->x0 / step_of(level)), j = (size_t)(r->y0 / step_of(level));
    return &l->patches[level][j * (size_t)count_of(l->width, level) + i];
}
