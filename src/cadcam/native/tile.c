/* From a triangle and a tile to samples: rows of 8.
 *
 * With a lens. Whether a sample lies inside is *defined* by P = a x + (b y + c) >= least in double at its plane point.
 * About the middle of a tile that point is affine in column i and row j to within (off_u, off_v) (patch.c), so that
 *     |P - (A i + B j + C)| <= slack = |a| off_u + |b| off_v + 2^-48 size,   size >= |a x| + |b y| + |c| everywhere:
 * A = a ux + b vx and its like are off by a few 2^-53 size, and so is P. A is kept at least 2^-20 |B| in size, which
 * moves the sum by less than 2^-18 |B| within the tile. Then P > 0 where i is further inside than X = -(B j + C) / A by
 * more than slack / |A|, and P < 0 where it is further outside. X is computed in float, from parts that are rounded to
 * 2^-24 of themselves, hence to 2^-22 of their sizes' sum; it is cut to 2^26, beyond any tile. Rows where a sample
 * lies closer than all this to an end of their span are drawn by P. */
#include "hot.h"
#ifdef __AVX2__ /* elsewhere tile_plain.c draws, with the same results */
#include "vectors.h"

/* A tile being drawn: where its samples lie in the plane, and what they hold. */
typedef struct {
    const double *x, *y; /* with a lens: plane points, 64 each */
    double left, above;  /* without: the first sample */
    float *z;
    int32_t *id;
} tile;

INLINE tile tile_at(const band *b, int32_t tx, int32_t ty) {
    const cc_lens *lens = b->frame->view->lens;
    const size_t wide = (size_t)b->frame->tiles_x, here = (size_t)(ty - b->first_tiles) * wide + (size_t)tx;
    tile t = {.left = tx * TILE, .above = ty * TILE, .z = b->worker->inverse_z + here * TILE_AREA,
              .id = b->worker->id + here * TILE_AREA};
    if (!lens) return t;
    const size_t at = ((size_t)ty * wide + (size_t)tx) * TILE_AREA;
    t.x = lens->x + at, t.y = lens->y + at;
    return t;
}

/* What a triangle has in common for the samples of a tile: held in registers. */
typedef struct {
    f8 near, far;
    i8 face;
    d4 across[2]; /* without a lens: a x of 1/z, the same in each row */
    double a, b, c;
} paint;

INLINE paint paint_of(const triangle *t, const tile *at) {
    const d4 first = at->left + *(const d4 *)COUNT, second = at->left + *(const d4 *)(COUNT + 4);
    return (paint){t->nearest - (f8){0}, t->farthest - (f8){0}, t->id + (i8){0},
                   {t->a[3] * first, t->a[3] * second}, t->a[3], t->b[3], t->c[3]};
}

/* 1/z in row r of a tile, evaluated in double. */
INLINE f8 inverse_z(const paint *p, const tile *at, int r) {
    if (at->x) {
        const double *x = at->x + r * TILE, *y = at->y + r * TILE;
        return floats(p->a * *(const d4 *)x + (p->b * *(const d4 *)y + p->c),
                      p->a * *(const d4 *)(x + 4) + (p->b * *(const d4 *)(y + 4) + p->c));
    }
    const double row = p->b * (at->above + r) + p->c;
    return floats(p->across[0] + row, p->across[1] + row);
}

/* Draw the samples of the mask in row r where the triangle is nearer than what is there. */
INLINE void draw_row(const paint *p, const tile *at, int r, i8 mask) {
    float *z = at->z + r * TILE;
    int32_t *id = at->id + r * TILE;
    const f8 here = *(const f8 *)z, w = most_of(least_of(inverse_z(p, at, r), p->near), p->far);
    const i8 who = *(const i8 *)id;
    mask &= (w > here) | ((w == here) & (p->face < who));
    *(f8 *)z = choose(mask, w, here);
    *(f8 *)id = choose(mask, (f8)p->face, (f8)who);
}

/* Those of a row that lie inside as the definition of P says; NaN, where nothing is seen, fails it. */
INLINE i8 inside_row(const triangle *t, const tile *at, int r) {
    l4 inside[2];
    for (int h = 0; h < 2; h++) {
        d4 x = at->left + *(const d4 *)(COUNT + 4 * h), y = at->above + r + (d4){0};
        if (at->x) x = *(const d4 *)(at->x + r * TILE + 4 * h), y = *(const d4 *)(at->y + r * TILE + 4 * h);
        inside[h] = ~(l4){0};
        for (int k = 0; k < 3; k++) inside[h] &= t->a[k] * x + (t->b[k] * y + t->c[k]) >= t->least[k];
    }
    return narrow(inside[0], inside[1]);
}

/* The tile has changed: how far is what it shows? Not asked at every change. */
INLINE void measure_tile(const band *b, const tile *at, int whole) {
    const size_t here = (size_t)(at->z - b->worker->inverse_z) / TILE_AREA;
    if (!whole && ++b->worker->changes[here] < 2) return;
    const f8 *row = (const f8 *)at->z;
    f8 least = row[0];
    for (int r = 1; r < TILE; r++) least = least_of(row[r], least);
    b->worker->farthest[here] = least_lane(least);
    b->worker->changes[here] = 0;
}

INLINE i8 between(const spans *s, int r, i8 column) { return (column >= s->left[r]) & (column <= s->right[r]); }

void VARIANT(draw_pixels)(const band *b, const triangle *t, const spans *s, unsigned rows, int32_t tx, int32_t ty) {
    const tile at = tile_at(b, tx, ty);
    const paint p = paint_of(t, &at);
    const i8 column = tx * TILE + *(const i8 *)LANE;
    i8 all = ~(i8){0};
    for (unsigned left = rows; left; left &= left - 1) {
        const int r = __builtin_ctz(left);
        const i8 inside = between(s, r, column);
        all &= inside;
        draw_row(&p, &at, r, inside);
    }
    measure_tile(b, &at, rows == 0xFF && signs(all) == 0xFF);
}

void VARIANT(draw_by_definition)(const band *b, const triangle *t, unsigned rows, int32_t tx, int32_t ty) {
    const tile at = tile_at(b, tx, ty);
    const paint p = paint_of(t, &at);
    for (; rows; rows &= rows - 1) draw_row(&p, &at, __builtin_ctz(rows), inside_row(t, &at, __builtin_ctz(rows)));
    measure_tile(b, &at, 0);
}

/* The spans of a triangle in a tile of an affine lens, in columns of the tile: in which rows there are any for sure, and
 * in which a sample is in doubt. */
INLINE void cross_tile(const triangle *t, const affine *map, spans *s, unsigned *met, unsigned *doubt) {
    const d4 a = *(const d4 *)t->a, b = *(const d4 *)t->b, none = {0};
    d4 A = a * map->ux + b * map->vx, least = size_d(a * map->uy + b * map->vy);
    const d4 B = a * map->uy + b * map->vy, C = a * map->u + (b * map->v + *(const d4 *)t->c);
    const d4 slack = size_d(a) * map->off_u + size_d(b) * map->off_v + *(const d4 *)t->size * 0x1p-48 + least * 0x1p-18;
    least = most_d(least * 0x1p-20, none + 1e-300);
    A = choose_d(A < none, least_d(A, -least), most_d(A, least));
    const d4 m = 1.0 / A, start = most_d(least_d(-C * m, none + 0x1p26), none - 0x1p26), slope = -B * m;
    const f4 middle = narrow_d(start + 3.5), turn = narrow_d(slope);
    const f4 off = narrow_d(size_d(slack * m) + (size_d(start) + size_d(slope) * 4.0 + 4.0) * 0x1p-22);
    const unsigned rights = signs_d((l4)A);
    const f8 row = __builtin_convertvector(*(const i8 *)LANE, f8) - 3.5f;
    f8 first = -0.5f - (f8){0}, first_sure = first, last = TILE - 0.5f + (f8){0}, last_sure = last;
    for (int k = 0; k < 3; k++) {
        const f8 X = middle[k] + turn[k] * row, low = X - off[k], high = X + off[k];
        if (rights >> k & 1) last = least_of(last, high), last_sure = least_of(last_sure, low);
        else first = most_of(first, low), first_sure = most_of(first_sure, high);
    }
    first = up(least_of(first, TILE + (f8){0})), first_sure = up(least_of(first_sure, TILE + (f8){0}));
    last = down(most_of(last, -1.0f - (f8){0})), last_sure = down(most_of(last_sure, -1.0f - (f8){0}));
    const i8 unsure = ((first != first_sure) | (last != last_sure)) & (first <= last);
    *doubt = signs(unsure), *met = signs((first <= last) & ~unsure);
    *(i8 *)s->left = __builtin_convertvector(first, i8), *(i8 *)s->right = __builtin_convertvector(last, i8);
}

void VARIANT(draw_points)(const band *b, const triangle *t, int32_t tx, int32_t ty) {
    const cc_lens *lens = b->frame->view->lens;
    const size_t of_lens = (size_t)ty * (size_t)b->frame->tiles_x + (size_t)tx;
    unsigned met = 0, doubt = 0xFF;
    spans s;
    if (!lens->partial[of_lens]) cross_tile(t, &lens->tile[of_lens], &s, &met, &doubt);
    if (!(met | doubt)) return;
    const tile at = tile_at(b, tx, ty);
    const paint p = paint_of(t, &at);
    const i8 column = *(const i8 *)LANE;
    i8 all = ~(i8){0};
    for (unsigned left = met; left; left &= left - 1) {
        const int r = __builtin_ctz(left);
        const i8 inside = between(&s, r, column);
        all &= inside;
        draw_row(&p, &at, r, inside);
    }
    for (unsigned left = doubt; left; left &= left - 1)
        draw_row(&p, &at, __builtin_ctz(left), inside_row(t, &at, __builtin_ctz(left)));
    measure_tile(b, &at, met == 0xFF && signs(all) == 0xFF);
}
#endif
