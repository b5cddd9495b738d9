/* Declarations shared by the hot files (HOT in build_backend/cadcam_build.py), each of which is compiled once for each
 * instruction set. CC_VARIANT is the suffix of their functions. */
#ifndef CADCAM_HOT_H
#define CADCAM_HOT_H

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"
#include "internal.h"
#include "vectors.h"

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)
#define VARIANT(name) JOIN(name, CC_VARIANT)

static inline double lower(double a, double b) { return a < b ? a : b; }
static inline double upper(double a, double b) { return a > b ? a : b; }
static inline double lower3(double a, double b, double c) { return lower(lower(a, b), c); }
static inline double upper3(double a, double b, double c) { return upper(upper(a, b), c); }
static inline int32_t imin(int32_t a, int32_t b) { return a < b ? a : b; }
static inline int32_t imax(int32_t a, int32_t b) { return a > b ? a : b; }

/* The part of a grid that a worker draws at a time. */
typedef struct {
    const cc_frame *frame;
    const grid *grid;
    const sheet *sheet;
    int32_t y0, y1;      /* samples, both included */
    int32_t first_tiles; /* row of tiles at the top */
} band;

/* A triangle ready to draw: three edges (inside: a x + (b y + c) >= least) and, last, the plane of 1/z. */
typedef struct {
    double a[4], b[4], c[4];
    double least[4]; /* of the edges, as size: the fourth fills a vector */
    double size[4]; /* at least |a x| + |b y| + |c| at every sample of the picture */
    float nearest, farthest; /* bounds of 1/z: those of its corners */
    int32_t id;
} triangle;

/* Four triangles side by side, a number of each in a vector. */
typedef struct {
    d4 a[4], b[4], c[4], least[4], size[4];
    float nearest[4], farthest[4];
    int32_t id[4];
} quartet;

INLINE d4 across(const d4 v[4], int m) { return (d4){v[0][m], v[1][m], v[2][m], v[3][m]}; }

INLINE triangle triangle_of(const quartet *q, int m) {
    triangle t = {.nearest = q->nearest[m], .farthest = q->farthest[m], .id = q->id[m]};
    *(d4 *)t.a = across(q->a, m), *(d4 *)t.b = across(q->b, m), *(d4 *)t.c = across(q->c, m);
    *(d4 *)t.least = across(q->least, m), *(d4 *)t.size = across(q->size, m);
    return t;
}

/* The same without its edges: what is drawn in spans that are sure does not ask for them. */
INLINE triangle plane_of(const quartet *q, int m) {
    triangle t;
    t.a[3] = q->a[3][m], t.b[3] = q->b[3][m], t.c[3] = q->c[3][m];
    t.nearest = q->nearest[m], t.farthest = q->farthest[m], t.id = q->id[m];
    return t;
}

#define NOWHERE ((rect){1, 0, 1, 0})
static inline int empty(rect r) { return (r.x0 > r.x1) | (r.y0 > r.y1); }
static inline rect whole_grid(const grid *g) { return (rect){0, g->width - 1, 0, g->height - 1}; }

/* Samples of a grid that look at the box [x0, x1] x [y0, y1] of the plane (pixels) or of the lens' cells. */
static inline rect samples_of(const grid *g, box b) {
    if (g->lens) {
        const double slack = 1e-6;
        return lens_samples(g->lens, (box){b.x0 - slack, b.x1 + slack, b.y0 - slack, b.y1 + slack});
    }
    const double slack = 1e-5, s = g->scale, t = g->shift; /* px: far above rounding */
    double x0 = ceil(upper(s * b.x0 + t - slack, 0)), x1 = floor(lower(s * b.x1 + t + slack, g->width - 1));
    double y0 = ceil(upper(s * b.y0 + t - slack, 0)), y1 = floor(lower(s * b.y1 + t + slack, g->height - 1));
    if (!(x0 <= x1 && y0 <= y1)) return NOWHERE;
    return (rect){(int32_t)x0, (int32_t)x1, (int32_t)y0, (int32_t)y1};
}

/* Whether n points all lie beyond one side of the picture (homogeneous, so true of points behind the camera too). */
static inline int beyond_a_side(const box *l, const double *x, const double *y, const double *z, const uint8_t *i,
                                int n) {
    int left = 1, right = 1, above = 1, below = 1, behind = 1;
    for (int k = 0; k < n; k++) {
        double px = x[i[k]], py = y[i[k]], pz = z[i[k]];
        left &= px < l->x0 * pz, right &= px > l->x1 * pz;
        above &= py < l->y0 * pz, below &= py > l->y1 * pz;
        behind &= pz <= 0;
    }
    return left | right | above | below | behind;
}

/* Coordinates in which boxes are taken: pixels, or cells of the lens' table. */
static inline double grid_y(const cc_lens *l, double v) { return l ? (squash(v) - l->origin_y) * l->scale_y : v; }
static inline double grid_x(const cc_lens *l, double u) { return l ? (squash(u) - l->origin_x) * l->scale_x : u; }

/* The largest value over a box of linear function k of a triangle. */
static inline double most(const triangle *t, int k, const box *b) {
    return t->a[k] * (t->a[k] > 0 ? b->x1 : b->x0) + (t->b[k] * (t->b[k] > 0 ? b->y1 : b->y0) + t->c[k]);
}

/* Where in the plane the samples of a block of 2^level x 2^level tiles lie that are in the triangle's rectangle. */
static inline box area_of(const grid *g, const rect *r, int level, int32_t bx, int32_t by) {
    if (g->lens) {
        int32_t wide = (g->tiles_x + (1 << level) - 1) >> level;
        return g->lens->block[level][(size_t)by * (size_t)wide + (size_t)bx];
    }
    int32_t size = TILE << level;
    return (box){imax(bx * size, r->x0), imin(bx * size + size - 1, r->x1), imax(by * size, r->y0),
                 imin(by * size + size - 1, r->y1)};
}

static inline int misses(const triangle *t, const box *area) {
    return (most(t, 0, area) < 0) | (most(t, 1, area) < 0) | (most(t, 2, area) < 0);
}

/* In each of the rows of a strip, the first and the last sample inside a triangle; left > right where there is none. */
typedef struct {
    _Alignas(32) int32_t left[TILE];
    _Alignas(32) int32_t right[TILE];
} spans;

/* strip.c or tile_plain.c: draw those of four triangles that have their bit set into the tiles of their rectangles. */
void VARIANT(draw_quartet)(const band *b, const quartet *q, const rect r[4], unsigned which);
/* bent.c, for strip.c: the same through a lens. */
void VARIANT(draw_through_lens)(const band *b, const triangle *t, const rect *r);
/* tile.c: draw into the rows of a tile that have their bit set: their spans, or, in doubt, sample by sample. */
void VARIANT(draw_tile)(const band *b, const triangle *t, const spans *s, unsigned rows, unsigned doubt, int32_t tx,
                        int32_t ty);
/* tile.c or tile_plain.c: clear a tile that nothing was drawn into yet. */
static inline void clear_tile(const band *b, size_t tile) {
    const sheet *s = b->sheet;
    const cc_lens *lens = b->grid->lens;
    s->changes[tile] = 0;
    memset(s->inverse_z + tile * TILE_AREA, 0, TILE_AREA * sizeof(float));
    memset(s->id + tile * TILE_AREA, 0xFF, TILE_AREA * sizeof(int32_t));
    const size_t of_lens = tile + (size_t)b->first_tiles * (size_t)b->grid->tiles_x;
    if (!lens || !lens->partial[of_lens]) return;
    for (int k = 0; k < TILE_AREA; k++) /* samples without a direction must not keep their tile open */
        if (isnan(lens->points[point_of((int32_t)of_lens, k)])) s->inverse_z[tile * TILE_AREA + k] = FLT_MAX;
}

/* shade.c: write the outputs of a band that has been drawn; `sums`: room for a row of them. */
void VARIANT(write_band)(const band *b, float *sums);

#endif
