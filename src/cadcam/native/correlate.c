/* Correlation: the search on a coarse grid, a block of positions and a group of orientations at a time. */
#include "correlate.h"
#include "hot.h"
#include "vectors.h"

enum { WIDE = 24, GROUP = 4, MARGIN = WIDE + 8 }; /* positions and orientations at a time, to fill the registers */

INLINE i8 pick(i8 mask, i8 yes, i8 no) { return (yes & mask) | (no & ~mask); }

enum { STRIP = 1024 }; /* px of a row at a time */

void VARIANT(shrink)(const cc_plane *p, int32_t factor, float *out) {
    float column[STRIP];
    const int32_t wide = imax(STRIP / factor, 1);
    for (int32_t y = 0; y < p->height; y += factor) {
        const int32_t rows = imin(factor, p->height - y);
        for (int32_t x = 0; x < p->width; x += wide * factor) {
            const int32_t n = imin(wide * factor, p->width - x);
            memset(column, 0, (size_t)n * sizeof *column);
            for (int32_t r = 0; r < rows; r++) {
                const float *row = p->pixels + (size_t)(y + r) * (size_t)p->width + x;
                for (int32_t c = 0; c < n; c++) column[c] += row[c];
            }
            for (int32_t c = 0; c < n; c += factor) {
                const int32_t columns = imin(factor, n - c);
                float s = 0;
                for (int32_t k = 0; k < columns; k++) s += column[c + k];
                *out++ = s / (float)(rows * columns);
            }
        }
    }
}

/* The second weakest of eight steps of brightness, by their ratio, as in correlate.h. */
static float spot_at(const cc_spots *s, const float *here, ptrdiff_t w) {
    float least = 2, second = 2;
    for (int d = 0; d < 8; d++) {
        const float out = here[s->dy_out[d] * w + s->dx_out[d]], in = here[s->dy_in[d] * w + s->dx_in[d]];
        const float total = out + in, step = (s->dark ? out - in : in - out) / (total > s->level ? total : s->level);
        const float more = step > least ? step : least;
        second = more < second ? more : second, least = step < least ? step : least;
    }
    return second;
}

static f8 eight_spots_at(const cc_spots *s, const float *here, ptrdiff_t w) {
    const f8 sign = eight(s->dark ? 1.0f : -1.0f), level = eight(s->level);
    f8 least = eight(2), second = eight(2);
    for (int d = 0; d < 8; d++) {
        const f8 out = load(here + s->dy_out[d] * w + s->dx_out[d]), in = load(here + s->dy_in[d] * w + s->dx_in[d]);
        const f8 step = sign * (out - in) / most_of(out + in, level);
        second = least_of(second, most_of(least, step)), least = least_of(least, step);
    }
    return second;
}

void VARIANT(spots)(const cc_spots *s) {
    const ptrdiff_t w = s->plane.width;
    for (int32_t y = s->reach; y < s->plane.height - s->reach; y++) {
        const float *row = s->plane.pixels + y * w;
        float *response = s->response + y * w;
        int32_t x = s->reach;
        for (; x + 8 <= s->plane.width - s->reach; x += 8) {
            const f8 found = eight_spots_at(s, row + x, w);
            memcpy(response + x, &found, sizeof found);
        }
        for (; x < s->plane.width - s->reach; x++) response[x] = spot_at(s, row + x, w);
    }
}

/* ---- the search */

/* The best of a block of positions so far. */
typedef struct { f8 best[3]; i8 which[3]; } block;

INLINE void keep(block *b, int k, f8 score, int32_t number, int either_sign) {
    if (either_sign) score = size_of(score);
    const i8 better = score > b->best[k], none = {0};
    b->best[k] = choose(better, score, b->best[k]);
    b->which[k] = pick(better, none + number, b->which[k]);
}

/* The sum of weights times pixels for GROUP orientations at WIDE positions; `weight` (taps, GROUP). */
INLINE void correlate(const float *p, const int32_t *at, const float *weight, int32_t taps, f8 s[GROUP][3]) {
    for (int g = 0; g < GROUP; g++) s[g][0] = s[g][1] = s[g][2] = eight(0);
    for (int32_t t = 0; t < taps; t++, weight += GROUP) {
        const float *q = p + at[t];
        const f8 a = load(q), b = load(q + 8), c = load(q + 16);
        for (int g = 0; g < GROUP; g++) {
            const f8 w = eight(weight[g]);
            s[g][0] = fused(w, a, s[g][0]), s[g][1] = fused(w, b, s[g][1]), s[g][2] = fused(w, c, s[g][2]);
        }
    }
}

/* One over the norm of the picture's deviation from its mean under the taps that count; 0 where it is flat. */
static void inverse_length(const float *p, const int32_t *at, const float *inside, int32_t taps, float least,
                           f8 out[3]) {
    f8 one[3] = {eight(0), eight(0), eight(0)}, two[3] = {eight(0), eight(0), eight(0)};
    float n = 0;
    for (int32_t t = 0; t < taps; t++) {
        if (inside[t] == 0) continue;
        n += 1;
        for (int k = 0; k < 3; k++) {
            const f8 v = load(p + at[t] + 8 * k);
            one[k] += v, two[k] = fused(v, v, two[k]);
        }
    }
    n = n > 0 ? n : 1;
    for (int k = 0; k < 3; k++) {
        const f8 square = two[k] - one[k] * one[k] / n;
        out[k] = choose(square > least * n, 1.0f / root(most_of(square, eight(1e-30f))), eight(0));
    }
}

/* All orientations share their mask: the best numerator is the best correlation. */
static void search_one_mask(const cc_search *s, const float *p, const int32_t *at, const float *weight, block *b) {
    f8 sums[GROUP][3], scale[3];
    for (int32_t g = 0; g < s->count; g += GROUP) {
        correlate(p, at, weight + (size_t)g * (size_t)s->taps, s->taps, sums);
        for (int i = 0; i < GROUP && g + i < s->count; i++)
            for (int k = 0; k < 3; k++) keep(b, k, sums[i][k], g + i, s->either_sign);
    }
    inverse_length(p, at, s->inside, s->taps, s->least_variance, scale);
    for (int k = 0; k < 3; k++) b->best[k] *= scale[k];
}

static void search_masks(const cc_search *s, const float *p, const int32_t *at, const float *weight, block *b) {
    f8 sums[GROUP][3], scale[3];
    for (int32_t g = 0; g < s->count; g += GROUP) {
        correlate(p, at, weight + (size_t)g * (size_t)s->taps, s->taps, sums);
        for (int i = 0; i < GROUP && g + i < s->count; i++) {
            inverse_length(p, at, s->inside + (size_t)(g + i) * (size_t)s->taps, s->taps, s->least_variance, scale);
            for (int k = 0; k < 3; k++) keep(b, k, sums[i][k] * scale[k], g + i, s->either_sign);
        }
    }
}

/* Weights (count, taps) as (groups, taps, GROUP), the last group filled up with zeros. */
static void grouped(const cc_search *s, float *out) {
    for (int32_t g = 0; g < s->count; g += GROUP)
        for (int32_t t = 0; t < s->taps; t++)
            for (int32_t i = g; i < g + GROUP; i++)
                *out++ = i < s->count ? s->weight[(size_t)i * (size_t)s->taps + (size_t)t] : 0;
}

/* Rows of a plane with MARGIN zeros after each: blocks may reach beyond the row. */
static void with_margin(const cc_plane *p, int32_t from, int32_t to, float *out) {
    for (int32_t y = from; y < to; y++, out += p->width + MARGIN) {
        memcpy(out, p->pixels + (size_t)y * (size_t)p->width, (size_t)p->width * sizeof *out);
        memset(out + p->width, 0, MARGIN * sizeof *out);
    }
}

/* The extent of the taps about a position. */
static rect reach_of(const cc_search *s) {
    rect r = {0, 0, 0, 0};
    for (int32_t t = 0; t < s->taps; t++) {
        r.x0 = imin(r.x0, s->dx[t]), r.x1 = imax(r.x1, s->dx[t]);
        r.y0 = imin(r.y0, s->dy[t]), r.y1 = imax(r.y1, s->dy[t]);
    }
    return r;
}

int32_t VARIANT(search_rows)(const cc_search *s, int32_t from, int32_t to) {
    const cc_plane *p = &s->plane;
    for (size_t i = (size_t)from * (size_t)p->width; i < (size_t)to * (size_t)p->width; i++)
        s->best[i] = 0, s->which[i] = -1;
    const rect r = reach_of(s);
    const int32_t top = imax(from, -r.y0), end = imin(to, p->height - r.y1), first = -r.x0, last = p->width - 1 - r.x1;
    if (top >= end || first > last || s->taps < 1 || s->count < 1) return 0;
    const int32_t row = p->width + MARGIN, low = top + r.y0, rows = end + r.y1 - low;
    const int32_t groups = (s->count + GROUP - 1) / GROUP;
    float *plane = malloc(((size_t)rows * (size_t)row + MARGIN) * sizeof *plane);
    float *weight = malloc((size_t)groups * GROUP * (size_t)s->taps * sizeof *weight);
    int32_t *at = malloc((size_t)s->taps * sizeof *at);
    const int fine = plane && weight && at;
    if (fine) {
        with_margin(p, low, low + rows, plane), grouped(s, weight);
        memset(plane + (size_t)rows * (size_t)row, 0, MARGIN * sizeof *plane);
        for (int32_t t = 0; t < s->taps; t++) at[t] = s->dy[t] * row + s->dx[t];
    }
    for (int32_t y = top; fine && y < end; y++)
        for (int32_t x = first; x <= last; x += WIDE) {
            block b = {.best = {eight(0), eight(0), eight(0)}, .which = {{0}, {0}, {0}}};
            for (int k = 0; k < 3; k++) b.which[k] -= 1;
            const float *here = plane + (size_t)(y - low) * (size_t)row + x;
            (s->masks == 1 ? search_one_mask : search_masks)(s, here, at, weight, &b);
            const size_t to_here = (size_t)y * (size_t)p->width + (size_t)x;
            const size_t bytes = (size_t)imin(WIDE, last - x + 1) * 4;
            memcpy(s->best + to_here, b.best, bytes), memcpy(s->which + to_here, b.which, bytes);
        }
    free(plane), free(weight), free(at);
    return fine ? 0 : -1;
}
