/* From a triangle and a tile to samples: rows of 8. */
#include "hot.h"
#ifdef __AVX2__ /* elsewhere tile_plain.c draws, with the same results */
#include "vectors.h"

/* A tile being drawn: where its samples lie in the plane, and what they hold. */
typedef struct {
    const double *points; /* with a lens: of the plane, row by row, TILE x and their y */
    double left, above;  /* without: the first sample */
    float *z;
    int32_t *id;
} tile;

INLINE tile tile_at(const band *b, int32_t tx, int32_t ty) {
    const cc_lens *lens = b->grid->lens;
    const size_t wide = (size_t)b->grid->tiles_x, here = (size_t)(ty - b->first_tiles) * wide + (size_t)tx;
    tile t = {.left = tx * TILE, .above = ty * TILE, .z = b->sheet->inverse_z + here * TILE_AREA,
              .id = b->sheet->id + here * TILE_AREA};
    if (!lens) return t;
    t.points = lens->points + point_of((int32_t)((size_t)ty * wide + (size_t)tx), 0);
    return t;
}

/* The values of a triangle shared by all samples of a tile, held in registers. */
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
    if (at->points) {
        const double *x = at->points + r * 2 * TILE, *y = x + TILE;
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
        const double *p = at->points + r * 2 * TILE + 4 * h;
        if (at->points) x = *(const d4 *)p, y = *(const d4 *)(p + TILE);
        inside[h] = ~(l4){0};
        for (int k = 0; k < 3; k++) inside[h] &= t->a[k] * x + (t->b[k] * y + t->c[k]) >= t->least[k];
    }
    return narrow(inside[0], inside[1]);
}

/* Update the bound of a changed tile's depth, not at every change. */
INLINE void measure_tile(const band *b, const tile *at, int whole) {
    const size_t here = (size_t)(at->z - b->sheet->inverse_z) / TILE_AREA;
    if (!whole && ++b->sheet->changes[here] < 2) return;
    const f8 *row = (const f8 *)at->z;
    f8 least = row[0];
    for (int r = 1; r < TILE; r++) least = least_of(row[r], least);
    b->sheet->farthest[here] = least_lane(least);
    b->sheet->changes[here] = 0;
}

INLINE i8 between(const spans *s, int r, i8 column) { return (column >= s->left[r]) & (column <= s->right[r]); }

/* Draw into some rows of a tile: their spans, or, in rows with samples in doubt, what the definition of P says. */
void VARIANT(draw_tile)(const band *b, const triangle *t, const spans *s, unsigned rows, unsigned doubt, int32_t tx,
                        int32_t ty) {
    const tile at = tile_at(b, tx, ty);
    const size_t here = (size_t)(at.z - b->sheet->inverse_z) / TILE_AREA;
    if (b->sheet->changes[here] == UNTOUCHED) clear_tile(b, here);
    const paint p = paint_of(t, &at);
    const i8 column = tx * TILE + *(const i8 *)LANE;
    i8 all = ~(i8){0};
    for (unsigned left = rows & ~doubt; left; left &= left - 1) {
        const int r = __builtin_ctz(left);
        const i8 inside = between(s, r, column);
        all &= inside;
        draw_row(&p, &at, r, inside);
    }
    for (unsigned left = rows & doubt; left; left &= left - 1) {
        const int r = __builtin_ctz(left);
        draw_row(&p, &at, r, inside_row(t, &at, r));
    }
    measure_tile(b, &at, rows == 0xFF && !doubt && signs(all) == 0xFF);
}
#endif
