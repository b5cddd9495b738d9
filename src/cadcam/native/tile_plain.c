/* From a triangle to the samples it covers, where there is no AVX2: all in double, as coverage is defined (raster.c),
 * in loops that compilers turn into whatever vectors there are. Results are those of tile.c, bit by bit. */
#include "hot.h"
#ifndef __AVX2__

/* The smallest value over a box of linear function k of a triangle. */
static inline double fewest(const triangle *t, int k, const box *b) {
    return t->a[k] * (t->a[k] > 0 ? b->x0 : b->x1) + (t->b[k] * (t->b[k] > 0 ? b->y0 : b->y1) + t->c[k]);
}

/* Keep 1/z = w of face `id` in the sample if it is nearer than what is there; w < 0 never is. */
static inline void keep(float w, int32_t face, float *z, int32_t *id) {
    int wins = (w > *z) | ((w == *z) & (face < *id));
    *z = wins ? w : *z;
    *id = wins ? face : *id;
}

/* Samples of the plane itself: rows `top` to `end` of the tile at (left, above); with `whole`, all lie inside. */
static inline void draw_pixels(const triangle *t, int32_t left, int32_t above, int top, int end, int whole,
                               float *restrict z, int32_t *restrict id) {
    double ax[4][TILE];
    const double near = t->nearest, far = t->farthest;
    const int32_t face = t->id;
    for (int j = 0; j < 4; j++)
        for (int i = 0; i < TILE; i++) ax[j][i] = t->a[j] * (double)(left + i);
    for (int k = top; k <= end; k++) {
        const double y = above + k, e0 = t->b[0] * y + t->c[0], e1 = t->b[1] * y + t->c[1];
        const double e2 = t->b[2] * y + t->c[2], ew = t->b[3] * y + t->c[3];
        for (int i = 0; i < TILE; i++) {
            double w = ax[3][i] + ew;
            w = w < near ? w : near;
            w = w > far ? w : far;
            int inside = whole || ((ax[0][i] + e0 >= t->least[0]) & (ax[1][i] + e1 >= t->least[1]) &
                                   (ax[2][i] + e2 >= t->least[2]));
            keep((float)(inside ? w : -1.0), face, &z[k * TILE + i], &id[k * TILE + i]);
        }
    }
}

/* Samples at the points of a lens' table; NaN fails every comparison. */
static inline void draw_points(const triangle *t, const double *restrict points, int top, int end, int whole,
                               float *restrict z, int32_t *restrict id) {
    const double near = t->nearest, far = t->farthest;
    const int32_t face = t->id;
    for (int k = top; k <= end; k++) {
        const double *x = points + k * 2 * TILE, *y = x + TILE;
        for (int i = 0; i < TILE; i++) {
            double w = t->a[3] * x[i] + (t->b[3] * y[i] + t->c[3]);
            w = w < near ? w : near;
            w = w > far ? w : far;
            int inside = whole ? x[i] == x[i]
                               : (t->a[0] * x[i] + (t->b[0] * y[i] + t->c[0]) >= t->least[0]) &
                                     (t->a[1] * x[i] + (t->b[1] * y[i] + t->c[1]) >= t->least[1]) &
                                     (t->a[2] * x[i] + (t->b[2] * y[i] + t->c[2]) >= t->least[2]);
            keep((float)(inside ? w : -1.0), face, &z[k * TILE + i], &id[k * TILE + i]);
        }
    }
}

static void measure_tile(const sheet *w, size_t tile) {
    const float *z = w->inverse_z + tile * TILE_AREA;
    float least[TILE];
    for (int i = 0; i < TILE; i++) least[i] = z[i];
    for (int r = 1; r < TILE; r++)
        for (int i = 0; i < TILE; i++) least[i] = z[r * TILE + i] < least[i] ? z[r * TILE + i] : least[i];
    float m = least[0];
    for (int i = 1; i < TILE; i++) m = least[i] < m ? least[i] : m;
    w->farthest[tile] = m;
    w->changes[tile] = 0;
}

static inline int contains(const triangle *t, const box *area) {
    return (fewest(t, 0, area) > DBL_MIN) & (fewest(t, 1, area) > DBL_MIN) & (fewest(t, 2, area) > DBL_MIN);
}

/* Draw into one tile; `small` triangles, of few rows in one tile, are not worth the tests. */
static inline void draw_tile(const band *b, const triangle *t, const rect *r, int32_t tx, int32_t ty, int small) {
    const grid *g = b->grid;
    const sheet *w = b->sheet;
    const cc_lens *lens = g->lens;
    size_t tile = (size_t)(ty - b->first_tiles) * (size_t)g->tiles_x + (size_t)tx;
    size_t of_lens = (size_t)ty * (size_t)g->tiles_x + (size_t)tx;
    int whole = 0, top = imax(r->y0 - ty * TILE, 0), end = imin(r->y1 - ty * TILE, TILE - 1);
    if (t->nearest < w->farthest[tile]) return;
    if (!small) {
        box area = area_of(g, r, 0, tx, ty);
        if (misses(t, &area)) return;
        if ((float)most(t, 3, &area) < w->farthest[tile] && t->farthest < w->farthest[tile]) return;
        int fits = r->x0 <= tx * TILE && r->x1 >= tx * TILE + TILE - 1 && end - top == TILE - 1;
        whole = fits && contains(t, &area);
    }
    if (w->changes[tile] == UNTOUCHED) clear_tile(b, tile);
    float *z = w->inverse_z + tile * TILE_AREA;
    int32_t *id = w->id + tile * TILE_AREA;
    if (lens) {
        const double *points = lens->points + point_of((int32_t)of_lens, 0);
        if (whole) draw_points(t, points, top, end, 1, z, id);
        else draw_points(t, points, top, end, 0, z, id);
    } else {
        if (whole) draw_pixels(t, tx * TILE, ty * TILE, top, end, 1, z, id);
        else draw_pixels(t, tx * TILE, ty * TILE, top, end, 0, z, id);
    }
    if (whole || ++w->changes[tile] >= 2) measure_tile(w, tile);
}

/* Descend into the blocks that the triangle meets: a sliver costs its length, not the area of its box. */
static void draw_block(const band *b, const triangle *t, const rect *r, int level, int32_t bx, int32_t by) {
    if (level == 0) {
        draw_tile(b, t, r, bx, by, 0);
        return;
    }
    box area = area_of(b->grid, r, level, bx, by);
    if (misses(t, &area)) return;
    int shift = level - 1 + 3; /* samples to blocks of the level below; TILE = 1 << 3 */
    int32_t x0 = imax(2 * bx, r->x0 >> shift), x1 = imin(2 * bx + 1, r->x1 >> shift);
    int32_t y0 = imax(2 * by, r->y0 >> shift), y1 = imin(2 * by + 1, r->y1 >> shift);
    for (int32_t y = y0; y <= y1; y++)
        for (int32_t x = x0; x <= x1; x++) draw_block(b, t, r, level - 1, x, y);
}

static void draw_triangle(const band *b, const triangle *t, const rect *r) {
    int32_t x0 = r->x0 / TILE, x1 = r->x1 / TILE, y0 = r->y0 / TILE, y1 = r->y1 / TILE;
    if (x0 == x1 && y0 == y1) {
        draw_tile(b, t, r, x0, y0, r->y1 - r->y0 < 4);
        return;
    }
    int level = 0;
    while ((x1 >> level) - (x0 >> level) > 1 || (y1 >> level) - (y0 >> level) > 1) level++;
    for (int32_t y = y0 >> level; y <= y1 >> level; y++)
        for (int32_t x = x0 >> level; x <= x1 >> level; x++) draw_block(b, t, r, level, x, y);
}

void VARIANT(draw_quartet)(const band *b, const quartet *q, const rect r[4], unsigned which) {
    for (; which; which &= which - 1) {
        const int m = __builtin_ctz(which);
        const triangle t = triangle_of(q, m);
        draw_triangle(b, &t, &r[m]);
    }
}
#endif
