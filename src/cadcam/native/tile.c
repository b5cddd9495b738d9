/* From a triangle and a tile to samples: rows of 8.
 *
 * Edges in float, with a lens. Whether a sample lies inside is *defined* by P = a x + (b y + c) >= least in double. Within a tile of
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
#include "vectors.h"

#define DOUBT 0x1p-18f

/* A tile being drawn: where its samples lie in the plane and about its centre, and what they hold. */
typedef struct {
    const double *x, *y; /* with a lens: plane points, 64 each */
    const float *n, *m;  /* with a lens: the same about the centre, 64 each */
    double left, above;  /* without: the first sample */
    float *z;
    int32_t *id;
} tile;

INLINE tile tile_at(const band *b, int32_t tx, int32_t ty, size_t here) {
    const cc_lens *lens = b->frame->view->lens;
    tile t = {.left = tx * TILE, .above = ty * TILE, .z = b->worker->inverse_z + here * TILE_AREA,
              .id = b->worker->id + here * TILE_AREA};
    if (!lens) return t;
    const size_t at = ((size_t)ty * (size_t)b->frame->tiles_x + (size_t)tx) * TILE_AREA;
    t.x = lens->x + at, t.y = lens->y + at, t.n = lens->n + at, t.m = lens->m + at;
    return t;
}

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
static __attribute__((noinline)) void draw_by_definition(const triangle *t, const tile *at, unsigned rows) {
    const paint p = paint_of(t, at);
    const int lens = at->x != NULL;
    for (; rows; rows &= rows - 1) {
        const int r = __builtin_ctz(rows);
        int32_t inside[TILE];
        for (int i = 0; i < TILE; i++) {
            double x = lens ? at->x[r * TILE + i] : at->left + i, y = lens ? at->y[r * TILE + i] : at->above + r;
            inside[i] = -1;
            for (int k = 0; k < 3; k++) inside[i] &= -(t->a[k] * x + (t->b[k] * y + t->c[k]) >= t->least[k]);
        }
        keep(&p, inverse_z(&p, at, r, lens), *(const i8 *)inside, at->z + r * TILE, at->id + r * TILE);
    }
}

/* The edges of a triangle about the centre of a tile: F = c + (a n + b m); the fourth is not used. */
typedef struct { f4 a, b, c; } edges;
enum { OUTSIDE, PARTLY, WHOLLY, UNSURE };

INLINE int about_tile(const triangle *t, const box *tile, edges *e) {
    const double hx = 0.5 * (tile->x1 - tile->x0), hy = 0.5 * (tile->y1 - tile->y0);
    const d4 a = *(const d4 *)t->a, b = *(const d4 *)t->b, c = *(const d4 *)t->c, none = {0};
    const d4 ax = a * hx, by = b * hy;
    const d4 reach = most_d(ax, -ax) + most_d(by, -by), s = 1.0 / reach;
    d4 middle = (a * (0.5 * (tile->x0 + tile->x1)) + (b * (0.5 * (tile->y0 + tile->y1)) + c)) * s;
    middle = most_d(least_d(middle, none + 4.0), none - 4.0);
    const l4 sure = (*(const d4 *)t->size * 0x1p-29 <= reach) & (reach >= 1e-250) & (reach <= 1e250);
    if ((signs_d(sure) & 7) != 7) return UNSURE;
    e->a = __builtin_convertvector(ax * s, f4), e->b = __builtin_convertvector(by * s, f4);
    e->c = __builtin_convertvector(middle, f4);
    if (signs_d(middle < -1.001) & 7) return OUTSIDE;
    return (signs_d(middle > 1.001) & 7) == 7 ? WHOLLY : PARTLY;
}

/* Which samples of some rows lie inside; which rows have any; whether one is in doubt. */
INLINE int test_rows(const tile *at, const edges *e, unsigned rows, i8 inside[TILE], unsigned *met) {
    const float a0 = e->a[0], a1 = e->a[1], a2 = e->a[2], b0 = e->b[0], b1 = e->b[1], b2 = e->b[2];
    const float c0 = e->c[0], c1 = e->c[1], c2 = e->c[2];
    i8 doubt = {0};
    *met = 0;
    for (; rows; rows &= rows - 1) {
        const int r = __builtin_ctz(rows);
        const f8 n = *(const f8 *)(at->n + r * TILE), m = *(const f8 *)(at->m + r * TILE);
        const f8 F0 = c0 + (a0 * n + b0 * m), F1 = c1 + (a1 * n + b1 * m), F2 = c2 + (a2 * n + b2 * m);
        const f8 least = least_of(least_of(F0, F1), F2);
        inside[r] = least > DOUBT;
        doubt |= (least >= -DOUBT) & ~inside[r];
        *met |= (unsigned)any(inside[r]) << r;
    }
    return any(doubt);
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

/* Draw into some rows of a tile of a distorting camera, or one of a triangle whose spans are unsure. */
void VARIANT(draw_points)(const band *b, const triangle *t, unsigned rows, int32_t tx, int32_t ty) {
    const cc_lens *lens = b->frame->view->lens;
    const size_t wide = (size_t)b->frame->tiles_x, here = (size_t)(ty - b->first_tiles) * wide + (size_t)tx;
    const tile at = tile_at(b, tx, ty, here);
    edges e;
    i8 inside[TILE];
    unsigned met = rows;
    int how = lens ? about_tile(t, &lens->block[0][(size_t)ty * wide + (size_t)tx], &e) : UNSURE;
    if (how == OUTSIDE) return;
    if (how == PARTLY && test_rows(&at, &e, rows, inside, &met)) how = UNSURE;
    if (how == UNSURE) draw_by_definition(t, &at, rows);
    else if (met) {
        const paint p = paint_of(t, &at);
        for (unsigned left = met; left; left &= left - 1) {
            const int r = __builtin_ctz(left);
            if (how == WHOLLY) inside[r] = *(const f8 *)(at.n + r * TILE) == *(const f8 *)(at.n + r * TILE); /* not NaN */
            keep(&p, inverse_z(&p, &at, r, 1), inside[r], at.z + r * TILE, at.id + r * TILE);
        }
    } else
        return;
    if (how == WHOLLY || ++b->worker->changes[here] >= 2) measure_tile(b->worker, here);
}

/* Draw the spans of some rows into a tile. */
void VARIANT(draw_pixels)(const band *b, const triangle *t, const spans *s, unsigned rows, int32_t tx, int32_t ty) {
    const size_t here = (size_t)(ty - b->first_tiles) * (size_t)b->frame->tiles_x + (size_t)tx;
    const tile at = tile_at(b, tx, ty, here);
    const paint p = paint_of(t, &at);
    const i8 column = tx * TILE + *(const i8 *)LANE;
    i8 all = ~(i8){0};
    for (unsigned left = rows; left; left &= left - 1) {
        const int r = __builtin_ctz(left);
        const i8 inside = (column >= s->left[r]) & (column <= s->right[r]);
        all &= inside;
        keep(&p, inverse_z(&p, &at, r, 0), inside, at.z + r * TILE, at.id + r * TILE);
    }
    const int whole = rows == 0xFF && signs(all) == 0xFF;
    if (whole || ++b->worker->changes[here] >= 2) measure_tile(b->worker, here);
}
#endif
