/* From a triangle to the samples it covers: blocks of 8 x 8 tiles, tiles, rows of 8 samples.
 *
 * Vectors are those of GCC and clang (vector_size) as AVX has them; with less, gcc takes them apart number by number.
 *
 * Edges in float. Whether a sample lies inside is *defined* by P = a x + (b y + c) >= least in double. Within a tile of
 * centre (xc, yc) and half size (hx, hy), with n = (x - xc) / hx and m = (y - yc) / hy in [-1, 1], the exact value is
 *     E = s (a x + b y + c) = s E(xc, yc) + s a hx n + s b hy m,    s = 1 / (|a| hx + |b| hy)
 * and F is that sum in float, its first term kept within +-4. With u = 2^-24: the coefficients of n and m add up to at
 * most 1 in size and each product is off by at most 3 u of it (coefficient, n or m, product), their sum by u, the first
 * term by 4 u and the total by 5 u: 13 u < 2^-20. The double values E(xc, yc) and P are each off by at most
 * 4 (2^-53) size, where size >= |a x| + |b y| + |c| everywhere; a tile is drawn in float only if 2^-29 size is at most
 * |a| hx + |b| hy, so that this is below 2^-20 in units of F. So |F| > DOUBT = 2^-18 has the sign of P, which is then
 * far from 0 and `least`; where the first term was cut, |F| >= 3. Tiles with samples in doubt are drawn again by P. */
#include "hot.h"
#ifdef __AVX__ /* elsewhere tile_plain.c draws, with the same results */
#include <immintrin.h>

typedef double d4 __attribute__((vector_size(32), may_alias, aligned(8)));
typedef int64_t l4 __attribute__((vector_size(32), may_alias, aligned(8)));
typedef float f8 __attribute__((vector_size(32), may_alias, aligned(4)));
typedef int32_t i8 __attribute__((vector_size(32), may_alias, aligned(4)));
typedef float f4 __attribute__((vector_size(16), may_alias, aligned(4)));
typedef int32_t i4 __attribute__((vector_size(16), may_alias, aligned(4)));

#define DOUBT 0x1p-18f
#define INLINE static inline __attribute__((always_inline))

enum { BLOCK = 3 }; /* level of the smallest block: 8 x 8 tiles, one vector of tiles a row */

/* n and m of pixels */
static const float STEPS[TILE] = {-0.875f, -0.625f, -0.375f, -0.125f, 0.125f, 0.375f, 0.625f, 0.875f};
static const double TILES[4] = {0, 8, 16, 24};
static const double COUNT[TILE] = {0, 1, 2, 3, 4, 5, 6, 7};

INLINE f8 choose(i8 mask, f8 yes, f8 no) { return (f8)_mm256_blendv_ps((__m256)no, (__m256)yes, (__m256)mask); }
INLINE f8 least_of(f8 a, f8 b) { return (f8)_mm256_min_ps((__m256)a, (__m256)b); }
INLINE f8 most_of(f8 a, f8 b) { return (f8)_mm256_max_ps((__m256)a, (__m256)b); }
INLINE d4 choose_d(l4 mask, d4 yes, d4 no) { return (d4)_mm256_blendv_pd((__m256d)no, (__m256d)yes, (__m256d)mask); }
INLINE f8 floats(d4 a, d4 b) { return (f8)_mm256_set_m128(_mm256_cvtpd_ps((__m256d)b), _mm256_cvtpd_ps((__m256d)a)); }
INLINE int any(i8 mask) { return !_mm256_testz_si256((__m256i)mask, (__m256i)mask); }
INLINE unsigned signs_d(l4 v) { return (unsigned)_mm256_movemask_pd((__m256d)v); }
INLINE unsigned signs_f(i4 v) { return (unsigned)_mm_movemask_ps((__m128)v); }

/* A tile being drawn: where its samples lie in the plane and about its centre, and what they hold. */
typedef struct {
    const double *x, *y; /* with a lens: plane points, 64 each */
    const float *n, *m;  /* with a lens: the same about the centre, 64 each */
    double left, above;  /* without: the first sample */
    int top, end;        /* rows to draw, both included */
    float *z;
    int32_t *id;
} tile;

/* What a triangle has in common for the samples of a tile: held in registers. */
typedef struct {
    f8 near, far;
    i8 face;
    d4 across[2]; /* without a lens: a x of 1/z, the same in each row */
    double a, b, c;
} paint;

/* Keep 1/z in the samples of the mask where it is nearer than what is there. */
INLINE void keep(const paint *p, f8 w, i8 mask, float *z, int32_t *id) {
    f8 here = *(const f8 *)z;
    i8 who = *(const i8 *)id;
    w = most_of(least_of(w, p->near), p->far);
    mask &= (w > here) | ((w == here) & (p->face < who));
    *(f8 *)z = choose(mask, w, here);
    *(f8 *)id = choose(mask, (f8)p->face, (f8)who);
}

INLINE paint paint_of(const triangle *t, const tile *at) {
    const d4 first = at->left + *(const d4 *)COUNT, second = at->left + *(const d4 *)(COUNT + 4);
    return (paint){t->nearest - (f8){0}, t->farthest - (f8){0}, t->id + (i8){0},
                   {t->a[3] * first, t->a[3] * second}, t->a[3], t->b[3], t->c[3]};
}

/* 1/z in row r of a tile, evaluated in double. */
INLINE f8 inverse_z(const paint *p, const tile *at, int r, int lens) {
    if (lens) {
        const double *x = at->x + r * TILE, *y = at->y + r * TILE;
        return floats(p->a * *(const d4 *)x + (p->b * *(const d4 *)y + p->c),
                      p->a * *(const d4 *)(x + 4) + (p->b * *(const d4 *)(y + 4) + p->c));
    }
    const double row = p->b * (at->above + r) + p->c;
    return floats(p->across[0] + row, p->across[1] + row);
}

/* Samples one by one, as the definition of P says. */
static void draw_by_definition(const triangle *t, const tile *at, int lens) {
    const paint p = paint_of(t, at);
    for (int r = at->top; r <= at->end; r++) {
        int32_t inside[TILE];
        for (int i = 0; i < TILE; i++) {
            double x = lens ? at->x[r * TILE + i] : at->left + i, y = lens ? at->y[r * TILE + i] : at->above + r;
            inside[i] = -1;
            for (int k = 0; k < 3; k++) inside[i] &= -(t->a[k] * x + (t->b[k] * y + t->c[k]) >= t->least[k]);
        }
        keep(&p, inverse_z(&p, at, r, lens), *(const i8 *)inside, at->z + r * TILE, at->id + r * TILE);
    }
}

INLINE void draw_whole(const triangle *t, const tile *at, int lens) {
    const paint p = paint_of(t, at);
    for (int r = at->top; r <= at->end; r++) {
        i8 seen = ~(i8){0};
        if (lens) seen = *(const f8 *)(at->n + r * TILE) == *(const f8 *)(at->n + r * TILE); /* not NaN */
        keep(&p, inverse_z(&p, at, r, lens), seen, at->z + r * TILE, at->id + r * TILE);
    }
}

/* The edges of a triangle about the centre of a tile: F = c + (a n + b m); the fourth is not used. */
typedef struct { f4 a, b, c; } edges;
enum { OUTSIDE, PARTLY, WHOLLY, UNSURE };

INLINE int about_tile(const triangle *t, const box *tile, edges *e) {
    const double hx = 0.5 * (tile->x1 - tile->x0), hy = 0.5 * (tile->y1 - tile->y0);
    const d4 a = *(const d4 *)t->a, b = *(const d4 *)t->b, c = *(const d4 *)t->c, none = {0};
    const d4 ax = a * hx, by = b * hy;
    const d4 reach = choose_d(ax < none, -ax, ax) + choose_d(by < none, -by, by), s = 1.0 / reach;
    d4 middle = (a * (0.5 * (tile->x0 + tile->x1)) + (b * (0.5 * (tile->y0 + tile->y1)) + c)) * s;
    middle = choose_d(middle < 4.0, middle, none + 4.0);
    middle = choose_d(middle > -4.0, middle, none - 4.0);
    const l4 sure = (*(const d4 *)t->size * 0x1p-29 <= reach) & (reach >= 1e-250) & (reach <= 1e250);
    if ((signs_d(sure) & 7) != 7) return UNSURE;
    e->a = __builtin_convertvector(ax * s, f4), e->b = __builtin_convertvector(by * s, f4);
    e->c = __builtin_convertvector(middle, f4);
    if (signs_d(middle < -1.001) & 7) return OUTSIDE;
    return (signs_d(middle > 1.001) & 7) == 7 ? WHOLLY : PARTLY;
}

/* Draw the samples inside the edges; whether there are any. First which, then, in rows that have some, their depth:
 * slivers pass between the samples of most of their tiles. */
INLINE int draw_partly(const triangle *t, const tile *at, const edges *e, int lens) {
    const float a0 = e->a[0], a1 = e->a[1], a2 = e->a[2], b0 = e->b[0], b1 = e->b[1], b2 = e->b[2];
    const float c0 = e->c[0], c1 = e->c[1], c2 = e->c[2];
    const f8 steps = *(const f8 *)STEPS, across0 = a0 * steps, across1 = a1 * steps, across2 = a2 * steps;
    i8 inside[TILE], doubt = {0};
    unsigned rows = 0;
    for (int r = at->top; r <= at->end; r++) {
        f8 F0, F1, F2;
        if (lens) {
            const f8 n = *(const f8 *)(at->n + r * TILE), m = *(const f8 *)(at->m + r * TILE);
            F0 = c0 + (a0 * n + b0 * m), F1 = c1 + (a1 * n + b1 * m), F2 = c2 + (a2 * n + b2 * m);
        } else {
            const float m = STEPS[r];
            F0 = (c0 + b0 * m) + across0, F1 = (c1 + b1 * m) + across1, F2 = (c2 + b2 * m) + across2;
        }
        f8 least = least_of(least_of(F0, F1), F2);
        inside[r] = least > DOUBT;
        doubt |= (least >= -DOUBT) & ~inside[r];
        rows |= (unsigned)any(inside[r]) << r;
    }
    if (any(doubt)) {
        draw_by_definition(t, at, lens);
        return 1;
    }
    if (!rows) return 0;
    const paint p = paint_of(t, at);
    for (; rows; rows &= rows - 1) {
        const int r = __builtin_ctz(rows);
        keep(&p, inverse_z(&p, at, r, lens), inside[r], at->z + r * TILE, at->id + r * TILE);
    }
    return 1;
}

INLINE int draw_rows(const triangle *t, const tile *at, const edges *e, int how, int lens) {
    if (how == PARTLY) return draw_partly(t, at, e, lens);
    if (how == WHOLLY) draw_whole(t, at, lens);
    else draw_by_definition(t, at, lens);
    return 1;
}

static void measure_tile(cc_worker *w, size_t tile) {
    const f8 *row = (const f8 *)(w->inverse_z + tile * TILE_AREA);
    f8 least = row[0];
    float lane[TILE];
    for (int r = 1; r < TILE; r++) least = least_of(row[r], least);
    memcpy(lane, &least, sizeof lane);
    for (int k = TILE / 2; k > 0; k /= 2)
        for (int i = 0; i < k; i++) lane[i] = lane[i + k] < lane[i] ? lane[i + k] : lane[i];
    w->farthest[tile] = lane[0];
    w->changes[tile] = 0;
}

static void draw_tile(const band *b, const triangle *t, const rect *r, int32_t tx, int32_t ty) {
    const cc_lens *lens = b->frame->view->lens;
    cc_worker *w = b->worker;
    size_t wide = (size_t)b->frame->tiles_x, here = (size_t)(ty - b->first_tiles) * wide + (size_t)tx;
    size_t of_lens = (size_t)ty * wide + (size_t)tx;
    tile at = {.left = tx * TILE, .above = ty * TILE, .top = imax(r->y0 - ty * TILE, 0),
               .end = imin(r->y1 - ty * TILE, TILE - 1),
               .z = w->inverse_z + here * TILE_AREA, .id = w->id + here * TILE_AREA};
    box area = {at.left - 0.5, at.left + TILE - 0.5, at.above - 0.5, at.above + TILE - 0.5};
    if (lens) area = lens->block[0][of_lens];
    edges e;
    int drawn, how = about_tile(t, &area, &e);
    if (how == OUTSIDE) return;
    if (lens) {
        at.x = lens->x + of_lens * TILE_AREA, at.y = lens->y + of_lens * TILE_AREA;
        at.n = lens->n + of_lens * TILE_AREA, at.m = lens->m + of_lens * TILE_AREA;
        drawn = draw_rows(t, &at, &e, how, 1);
    } else
        drawn = draw_rows(t, &at, &e, how, 0);
    if (drawn && (how == WHOLLY || ++w->changes[here] >= 2)) measure_tile(w, here);
}

/* Which of 4 tiles a triangle meets and may be seen in, as bits: their bounds, and what they hold. */
INLINE unsigned may_show(const triangle *t, d4 x0, d4 x1, d4 y0, d4 y1, f4 farthest) {
    const d4 none = {0};
    d4 most[4];
    for (int k = 0; k < 4; k++) {
        const d4 a = t->a[k] + none, b = t->b[k] + none;
        most[k] = a * choose_d(a > none, x1, x0) + (b * choose_d(b > none, y1, y0) + t->c[k]);
    }
    l4 misses = (most[0] < none) | (most[1] < none) | (most[2] < none);
    f4 w = __builtin_convertvector(most[3], f4);
    i4 hidden = ((w < farthest) & (t->farthest < farthest)) | (t->nearest < farthest);
    return 15 & ~(signs_d(misses) | signs_f(hidden));
}

/* Draw into tiles x0 to x1 of a row. */
static void draw_strip(const band *b, const triangle *t, const rect *r, int32_t x0, int32_t x1, int32_t ty) {
    const cc_frame *f = b->frame;
    const cc_lens *lens = f->view->lens;
    const d4 none = {0}, low = r->x0 + none, high = r->x1 + none;
    const d4 top = imax(ty * TILE, r->y0) + none, end = imin(ty * TILE + TILE - 1, r->y1) + none;
    const size_t wide = (size_t)f->tiles_x, of_lens = (size_t)ty * wide;
    const float *farthest = b->worker->farthest + (size_t)(ty - b->first_tiles) * wide;
    for (int32_t first = x0; first <= x1; first += 4) {
        const f4 far = *(const f4 *)(farthest + first);
        unsigned show;
        if (lens) {
            double *const *side = lens->side;
            const size_t at = of_lens + (size_t)first;
            show = may_show(t, *(const d4 *)(side[0] + at), *(const d4 *)(side[1] + at), *(const d4 *)(side[2] + at),
                            *(const d4 *)(side[3] + at), far);
        } else {
            const d4 left = first * TILE + *(const d4 *)TILES, right = left + (TILE - 1);
            show = may_show(t, choose_d(left > low, left, low), choose_d(right < high, right, high), top, end, far);
        }
        if (x1 - first < 3) show &= (2u << (x1 - first)) - 1;
        for (; show; show &= show - 1) draw_tile(b, t, r, first + __builtin_ctz(show), ty);
    }
}

/* Descend into the blocks that the triangle meets: a sliver costs its length, not the area of its box. */
static void draw_block(const band *b, const triangle *t, const rect *r, int level, int32_t bx, int32_t by) {
    int shift = (level == BLOCK ? 0 : level - 1) + 3; /* samples to what is below; TILE = 1 << 3 */
    int count = level == BLOCK ? 1 << BLOCK : 2;
    int32_t x0 = imax(count * bx, r->x0 >> shift), x1 = imin(count * bx + count - 1, r->x1 >> shift);
    int32_t y0 = imax(count * by, r->y0 >> shift), y1 = imin(count * by + count - 1, r->y1 >> shift);
    if (level == BLOCK) {
        for (int32_t y = y0; y <= y1; y++) draw_strip(b, t, r, x0, x1, y);
        return;
    }
    for (int32_t y = y0; y <= y1; y++)
        for (int32_t x = x0; x <= x1; x++) {
            box area = area_of(b->frame, r, level - 1, x, y);
            if (!misses(t, &area)) draw_block(b, t, r, level - 1, x, y);
        }
}

void VARIANT(draw_triangle)(const band *b, const triangle *t, const rect *r) {
    int32_t x0 = r->x0 / TILE, x1 = r->x1 / TILE, y0 = r->y0 / TILE, y1 = r->y1 / TILE;
    if (x0 == x1 && y0 == y1) {
        draw_tile(b, t, r, x0, y0);
        return;
    }
    int level = BLOCK;
    while ((x1 >> level) - (x0 >> level) > 1 || (y1 >> level) - (y0 >> level) > 1) level++;
    for (int32_t y = y0 >> level; y <= y1 >> level; y++)
        for (int32_t x = x0 >> level; x <= x1 >> level; x++) draw_block(b, t, r, level, x, y);
}
#endif
