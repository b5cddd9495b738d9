/* Edges of a part slid over a whole direction field, in bytes: see field.h. Compiled once for each instruction set. */
#include "place.h"

#define LANES 32
#define HIGH (CC_SPARE + 1) /* rows whose sums are held in registers */

typedef uint8_t bytes __attribute__((vector_size(LANES), may_alias, aligned(1)));

typedef struct {
    uint8_t *planes, *sums;
    int32_t stride, rows;  /* of a padded plane */
    int32_t wide, height;  /* of the sums, a multiple of LANES, and the field */
    double scale;          /* of a byte of the field */
} swept;

/* Copy the planes, quantised to `levels` steps, with empty margins around them. */
static swept prepared(const cc_field *f, int32_t levels, uint8_t *scratch) {
    const int32_t rows = f->height + 2 * CC_MARGIN + CC_SPARE;
    swept s = {.planes = scratch, .rows = rows, .height = f->height, .scale = levels / 255.0};
    s.wide = (f->width + LANES - 1) / LANES * LANES;
    s.stride = s.wide + 2 * CC_MARGIN;
    const size_t plane = (size_t)s.stride * (size_t)s.rows;
    memset(s.planes, 0, CC_SECTORS * plane);
    for (int k = 0; k < CC_SECTORS; k++)
        for (int32_t y = 0; y < f->height; y++) {
            const uint8_t *from = f->planes + ((size_t)k * (size_t)f->height + (size_t)y) * (size_t)f->width;
            const size_t row = ((size_t)y + CC_MARGIN) * (size_t)s.stride;
            uint8_t *restrict to = s.planes + (size_t)k * plane + row + CC_MARGIN;
            for (int32_t x = 0; x < f->width; x++) to[x] = (uint8_t)((from[x] * levels + 127) / 255);
        }
    s.sums = scratch + CC_SECTORS * plane;
    return s;
}

/* Add up the planes shifted by n offsets, HIGH rows at a time; zero beyond the field. */
static void add_up(const swept *s, int32_t width, const size_t *offset, int32_t n) {
    const size_t stride = (size_t)s->stride, wide = (size_t)s->wide;
    bytes inside;
    for (int32_t i = 0; i < LANES; i++) inside[i] = s->wide - LANES + i < width ? 255 : 0;
    for (int32_t y = 0; y < s->height; y += HIGH)
        for (int32_t x = 0; x < s->wide; x += LANES) {
            const uint8_t *from = s->planes + (size_t)y * stride + (size_t)x;
            uint8_t *to = s->sums + (size_t)y * wide + (size_t)x;
            bytes sum[HIGH] = {{0}};
            for (int32_t k = 0; k < n; k++)
                for (size_t j = 0; j < HIGH; j++) sum[j] += *(const bytes *)(from + offset[k] + j * stride);
            if (x + LANES == s->wide)
                for (size_t j = 0; j < HIGH; j++) sum[j] &= inside;
            for (size_t j = 0; j < HIGH; j++) *(bytes *)(to + j * wide) = sum[j];
        }
}

/* The largest of the sums: its value, and where it comes first. */
static int32_t largest(const swept *s, int32_t *x, int32_t *y) {
    const size_t n = (size_t)s->wide * (size_t)s->height;
    bytes most = {0};
    for (size_t i = 0; i < n; i += LANES) {
        const bytes here = *(const bytes *)(s->sums + i), more = (bytes)(here > most);
        most = (here & more) | (most & ~more);
    }
    uint8_t best = 0;
    for (int i = 0; i < LANES; i++) best = most[i] > best ? most[i] : best;
    const ptrdiff_t at = (const uint8_t *)memchr(s->sums, best, n) - s->sums;
    *x = (int32_t)(at % s->wide), *y = (int32_t)(at / s->wide);
    return best;
}

/* The largest of the sums at places around one, some third and sixth of a part's size away. */
static int32_t largest_beside(const swept *s, int32_t width, int32_t x, int32_t y) {
    static const int32_t aside[8][2] = {{10, 3}, {-3, 10}, {-10, -3}, {3, -10}, {3, 5}, {-5, 3}, {-3, -5}, {5, -3}};
    int32_t most = 0;
    for (int k = 0; k < 8; k++) {
        const int32_t i = x + aside[k][0], j = y + aside[k][1];
        if (i < 0 || j < 0 || i >= width || j >= s->height) continue;
        most = imax(most, s->sums[(size_t)j * (size_t)s->wide + (size_t)i]);
    }
    return most;
}

void VARIANT(sweep_field)(const cc_pose_edges *v, int32_t eye, const double *poses, int32_t keep, int32_t apart,
                          uint8_t *scratch, int32_t *shift, float *score) {
    const cc_eye *e = &v->eyes[eye];
    const cc_field *f = &e->field;
    int32_t most = 1;
    for (int64_t k = 0; k < v->n_poses; k++) most = imax(most, imin(v->count[k * v->n_eyes + eye], CC_SWEPT));
    const swept s = prepared(f, 255 / most, scratch);
    const int32_t cx = nearest(e->cx), cy = nearest(e->cy);
    for (int64_t k = 0; k < v->n_poses; k++) {
        const rigid c = seen_by(e, poses + 12 * k);
        const cc_place *places = v->places + v->first[k * v->n_eyes + eye];
        size_t offset[CC_SWEPT];
        int32_t n = 0;
        double variance = 1e-9;
        for (int32_t i = 0; i < imin(v->count[k * v->n_eyes + eye], CC_SWEPT); i++) {
            spot at;
            if (!image_of(e, &c, &places[i], &at)) continue;
            const int32_t x = nearest(at.x) - cx + CC_MARGIN, y = nearest(at.y) - cy + CC_MARGIN;
            const int32_t sector = sector_of(at.dx, at.dy);
            if (x < 0 || y < 0 || x > 2 * CC_MARGIN || y > 2 * CC_MARGIN) continue;
            offset[n++] = ((size_t)sector * (size_t)s.rows + (size_t)y) * (size_t)s.stride + (size_t)x;
            variance += s.scale * s.scale * f->variance[sector] + 1.0 / 12;
        }
        add_up(&s, f->width, offset, n);
        for (int32_t i = 0; i < keep; i++) {
            int32_t x = 0, y = 0;
            const int32_t best = largest(&s, &x, &y);
            shift[2 * (keep * k + i)] = x, shift[2 * (keep * k + i) + 1] = y;
            const int32_t beside = largest_beside(&s, f->width, x, y);
            score[keep * k + i] = best > 0 ? (float)((best - beside) / sqrt(variance)) : -INFINITY;
            const int32_t left = imax(0, x - apart), right = imin(s.wide - 1, x + apart);
            for (int32_t j = imax(0, y - apart); j <= imin(s.height - 1, y + apart); j++)
                memset(s.sums + (size_t)j * (size_t)s.wide + left, 0, (size_t)(right - left + 1));
        }
    }
}
