/* The table of a distorting camera, and its inverse: from a region of the plane to the pixels that see it. */
#include <math.h>
#include <stdlib.h>

#include "internal.h"

#define TINY 1e-300 /* directions that differ by less share a cell: one over it times a width is still a number */

static const short_rect NOWHERE = {UINT16_MAX, 0, UINT16_MAX, 0};
static const box NOTHING = {INFINITY, -INFINITY, INFINITY, -INFINITY};

static void grow_rect(short_rect *r, const short_rect *other) {
    if (other->x0 < r->x0) r->x0 = other->x0;
    if (other->x1 > r->x1) r->x1 = other->x1;
    if (other->y0 < r->y0) r->y0 = other->y0;
    if (other->y1 > r->y1) r->y1 = other->y1;
}

static void grow_box(box *b, double x, double y) {
    if (x < b->x0) b->x0 = x;
    if (x > b->x1) b->x1 = x;
    if (y < b->y0) b->y0 = y;
    if (y > b->y1) b->y1 = y;
}

/* Points tile by tile, with the bounds of each tile. */
static void fill_tiles(cc_lens *l, const double *points) {
    l->all = NOTHING;
    for (int32_t t = 0; t < l->tiles_x * l->tiles_y; t++) {
        int32_t left = t % l->tiles_x * TILE, top = t / l->tiles_x * TILE;
        box *b = &l->block[0][t];
        *b = NOTHING;
        l->partial[t] = 0;
        for (int k = 0; k < TILE_AREA; k++) {
            int32_t px = left + k % TILE, py = top + k / TILE;
            const double *p = points + 2 * ((size_t)py * (size_t)l->width + (size_t)px);
            int seen = px < l->width && py < l->height && isfinite(p[0]) && isfinite(p[1]);
            double *at = l->points + point_of(t, k);
            at[0] = seen ? p[0] : NAN, at[TILE] = seen ? p[1] : NAN;
            if (seen) grow_box(b, p[0], p[1]);
            else l->partial[t] = 1;
        }
        l->side[0][t] = b->x0, l->side[1][t] = b->x1, l->side[2][t] = b->y0, l->side[3][t] = b->y1;
        if (b->x0 <= b->x1) grow_box(&l->all, b->x0, b->y0), grow_box(&l->all, b->x1, b->y1);
    }
}

/* Bounds of 2 x 2 blocks of the level below, up to one block. */
static int fill_blocks(cc_lens *l) {
    int32_t wide = l->tiles_x, high = l->tiles_y;
    for (int k = 1; k <= 3 || wide > 1 || high > 1; k++) { /* 3: bent.c asks for it */
        int32_t nx = (wide + 1) / 2, ny = (high + 1) / 2;
        l->block[k] = malloc((size_t)nx * (size_t)ny * sizeof(box));
        if (!l->block[k]) return 0;
        for (size_t i = 0; i < (size_t)nx * (size_t)ny; i++) l->block[k][i] = NOTHING;
        for (int32_t j = 0; j < high; j++)
            for (int32_t i = 0; i < wide; i++) {
                const box *below = &l->block[k - 1][(size_t)j * (size_t)wide + (size_t)i];
                box *b = &l->block[k][(size_t)(j / 2) * (size_t)nx + (size_t)(i / 2)];
                if (below->x0 <= below->x1) grow_box(b, below->x0, below->y0), grow_box(b, below->x1, below->y1);
            }
        wide = nx, high = ny;
    }
    return 1;
}

static int make_level(cc_lens *l, int32_t k, int32_t nx, int32_t ny) {
    l->cells_x[k] = nx, l->cells_y[k] = ny;
    l->cell[k] = malloc((size_t)nx * (size_t)ny * sizeof(short_rect));
    if (!l->cell[k]) return 0;
    l->levels = k + 1;
    for (size_t i = 0; i < (size_t)nx * (size_t)ny; i++) l->cell[k][i] = NOWHERE;
    return 1;
}

/* Cells of about a pixel: the rectangle of the pixels whose points lie inside; empty for many. */
static int fill_cells(cc_lens *l) {
    if (!(l->all.x0 <= l->all.x1)) return make_level(l, 0, 1, 1);
    l->origin_x = squash(l->all.x0), l->origin_y = squash(l->all.y0);
    double range_x = squash(l->all.x1) - l->origin_x, range_y = squash(l->all.y1) - l->origin_y;
    int32_t nx = l->width, ny = l->height;
    l->scale_x = range_x > TINY ? nx / range_x : 0, l->scale_y = range_y > TINY ? ny / range_y : 0;
    if (!make_level(l, 0, nx + 1, ny + 1)) return 0;
    for (int32_t t = 0; t < l->tiles_x * l->tiles_y; t++)
        for (int k = 0; k < TILE_AREA; k++) {
            const double *at = l->points + point_of(t, k);
            if (isnan(at[0])) continue;
            uint16_t px = (uint16_t)(t % l->tiles_x * TILE + k % TILE);
            uint16_t py = (uint16_t)(t / l->tiles_x * TILE + k / TILE);
            int32_t cx = (int32_t)((squash(at[0]) - l->origin_x) * l->scale_x);
            int32_t cy = (int32_t)((squash(at[TILE]) - l->origin_y) * l->scale_y);
            grow_rect(&l->cell[0][(size_t)cy * (size_t)(nx + 1) + (size_t)cx], &(short_rect){px, px, py, py});
        }
    return 1;
}

static int fill_pyramid(cc_lens *l) {
    for (int32_t k = 1; l->cells_x[k - 1] > 1 || l->cells_y[k - 1] > 1; k++) {
        int32_t wide = l->cells_x[k - 1], high = l->cells_y[k - 1], nx = (wide + 1) / 2, ny = (high + 1) / 2;
        if (!make_level(l, k, nx, ny)) return 0;
        for (int32_t j = 0; j < high; j++)
            for (int32_t i = 0; i < wide; i++)
                grow_rect(&l->cell[k][(size_t)(j / 2) * (size_t)nx + (size_t)(i / 2)],
                          &l->cell[k - 1][(size_t)j * (size_t)wide + (size_t)i]);
    }
    return 1;
}

CC_API cc_lens *cc_lens_new(const double *points, int32_t width, int32_t height) {
    cc_lens *l = calloc(1, sizeof *l);
    if (!l) return NULL;
    l->width = width, l->height = height;
    l->tiles_x = (width + TILE - 1) / TILE, l->tiles_y = (height + TILE - 1) / TILE;
    size_t tiles = (size_t)l->tiles_x * (size_t)l->tiles_y;
    l->points = aligned_block(2 * tiles * TILE_AREA * sizeof(double));
    int made = 1;
    for (int k = 0; k < 4; k++) made &= (l->side[k] = calloc(tiles + 8, sizeof(double))) != NULL;
    l->block[0] = malloc(tiles * sizeof(box));
    l->partial = malloc(tiles);
    if (made && l->points && l->block[0] && l->partial) {
        fill_tiles(l, points);
        if (fill_blocks(l) && fill_cells(l) && fill_pyramid(l) && fill_patches(l, points)) return l;
    }
    cc_lens_free(l);
    return NULL;
}

CC_API void cc_lens_free(cc_lens *l) {
    if (!l) return;
    for (int32_t k = 0; k < l->levels; k++) free(l->cell[k]);
    aligned_release(l->points), free(l->partial);
    for (int k = 0; k < 4; k++) free(l->side[k]);
    for (int k = 0; k < 16; k++) free(l->block[k]);
    free_patches(l);
    free(l);
}

static int32_t clamped(double v, int32_t most) { return v > 0 ? (v < most ? (int32_t)v : most) : 0; }

rect lens_samples(const cc_lens *l, box b) {
    int32_t nx = l->cells_x[0], ny = l->cells_y[0];
    if (!(b.x1 >= 0 && b.x0 < nx && b.y1 >= 0 && b.y0 < ny)) return (rect){1, 0, 1, 0};
    int32_t i0 = clamped(b.x0, nx - 1), i1 = clamped(b.x1, nx - 1);
    int32_t j0 = clamped(b.y0, ny - 1), j1 = clamped(b.y1, ny - 1), level = 0;
    while (((i1 >> level) - (i0 >> level)) > 4 || ((j1 >> level) - (j0 >> level)) > 4) level++;
    short_rect found = NOWHERE;
    for (int32_t j = j0 >> level; j <= j1 >> level; j++)
        for (int32_t i = i0 >> level; i <= i1 >> level; i++)
            grow_rect(&found, &l->cell[level][(size_t)j * (size_t)l->cells_x[level] + (size_t)i]);
    return (rect){found.x0, found.x1, found.y0, found.y1};
}
