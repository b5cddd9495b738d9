/* Correlation: the search on a coarse grid, a block of positions and a group of orientations at a time, and the climb
 * to the sub-pixel peak (inverse compositional Gauss-Newton on the normalised correlation). */
#include "correlate.h"
#include "hot.h"
#include "vectors.h"

enum { WIDE = 24, GROUP = 4, MARGIN = WIDE + 8 }; /* positions and orientations at a time, to fill the registers */

#ifdef __AVX2__
INLINE f8 gathered(const float *p, i8 at) { return (f8)_mm256_i32gather_ps(p, (__m256i)at, 4); }
INLINE i8 whole_f(f8 v) { return (i8)_mm256_cvttps_epi32((__m256)v); }
INLINE f8 real(i8 v) { return (f8)_mm256_cvtepi32_ps((__m256i)v); }
#else
INLINE f8 gathered(const float *p, i8 at) {
    f8 v;
    for (int k = 0; k < 8; k++) v[k] = p[at[k]];
    return v;
}
INLINE i8 whole_f(f8 v) {
    i8 w;
    for (int k = 0; k < 8; k++) w[k] = (int32_t)v[k];
    return w;
}
INLINE f8 real(i8 v) {
    f8 w;
    for (int k = 0; k < 8; k++) w[k] = (float)v[k];
    return w;
}
#endif
INLINE f8 load(const float *p) { return *(const f8 *)p; }
INLINE i8 pick(i8 mask, i8 yes, i8 no) { return (yes & mask) | (no & ~mask); }
INLINE i8 within(i8 v, int32_t last) { /* clamped to 0 .. last */
    const i8 none = {0}, top = none + last;
    v = pick(v < 0, none, v);
    return pick(v > last, top, v);
}
static float sum(f8 v) {
    float s = 0;
    for (int k = 0; k < 8; k++) s += v[k];
    return s;
}

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

/* ---- the climb */

/* Points lie in [0, width - 1) x [0, height - 1): sums_at sees to it. */
INLINE f8 bilinear(const cc_plane *p, f8 x, f8 y) {
    const i8 i = whole_f(x), j = whole_f(y), at = j * p->width + i;
    const f8 a = x - real(i), b = y - real(j);
    const float *above = p->pixels, *below = above + p->width;
    const f8 g00 = gathered(above, at), g01 = gathered(above + 1, at);
    const f8 g10 = gathered(below, at), g11 = gathered(below + 1, at);
    const f8 upper = fused(a, g01 - g00, g00), lower = fused(a, g11 - g10, g10);
    return fused(b, lower - upper, upper);
}

/* The cubic B-spline's weights of four coefficients, the second at the pixel before. */
INLINE void cubic_weights(f8 t, f8 w[4]) {
    const f8 r = 1.0f - t, t2 = t * t, r2 = r * r;
    const float third = 2.0f / 3, sixth = 1.0f / 6;
    w[0] = sixth * r2 * r, w[1] = third - t2 * (1.0f - 0.5f * t), w[2] = third - r2 * (1.0f - 0.5f * r);
    w[3] = sixth * t2 * t;
}

/* Points lie in [1, width - 2) x [1, height - 2) of the coefficients. */
INLINE f8 cubic(const cc_plane *p, f8 x, f8 y) {
    const i8 i = whole_f(x), j = whole_f(y), at = (j - 1) * p->width + (i - 1);
    f8 wx[4], wy[4], s = eight(0);
    cubic_weights(x - real(i), wx), cubic_weights(y - real(j), wy);
    const float *row[8];
    for (int k = 0; k < 8; k++) row[k] = p->pixels + at[k];
    for (int l = 0; l < 4; l++) {
        f8 column[4];
        transposed(row, column);
        const f8 here = fused(wx[0], column[0], wx[1] * column[1]) + fused(wx[2], column[2], wx[3] * column[3]);
        s = fused(wy[l], here, s);
        for (int k = 0; k < 8; k++) row[k] += p->width;
    }
    return s;
}

enum { TAIL = 8, ROOM = 8 }; /* px: reach of a coefficient, beyond it 1e-5 are left; that a climb moves within a part */

/* What is read between pixels: the picture, or coefficients of the spline through a part of it, from pixel (x, y) on.
 * `spare` (capacity) holds two of these. */
typedef struct {
    cc_plane plane;
    int32_t x, y;
    float *spare;
    size_t capacity;
} part;

/* Coefficients of the cubic spline through values `stride` apart (M. Unser, Splines, 1999), TAIL strides further on. */
static void through(const float *restrict in, size_t n, size_t stride, float *restrict out) {
    float weight[TAIL + 1];
    const double pole = sqrt(3.0) - 2;
    double next = 1, all = 1;
    for (int k = 1; k <= TAIL; k++) next *= pole, all += 2 * next, weight[k] = (float)next;
    for (int k = 1; k <= TAIL; k++) weight[k] = (float)(weight[k] / all);
    weight[0] = (float)(1 / all);
    for (size_t i = 0; i < n; i++) {
        const float *at = in + i + TAIL * stride;
        float s = weight[0] * at[0];
        for (size_t k = 1; k <= TAIL; k++) s += weight[k] * (at[k * stride] + *(at - k * stride));
        out[i] = s;
    }
}

/* Fit the spline to a part of the picture, beyond whose border its last pixels are repeated; 0 where memory is short. */
static int fitted(const cc_plane *p, rect r, part *q) {
    const int32_t width = r.x1 - r.x0 + 1 + 2 * TAIL, height = r.y1 - r.y0 + 1 + 2 * TAIL;
    const size_t row = (size_t)width, size = row * (size_t)height;
    if (q->capacity < size) {
        free(q->spare);
        q->spare = malloc(2 * size * sizeof *q->spare), q->capacity = q->spare ? size : 0;
        if (!q->spare) return 0;
    }
    float *out = q->spare, *down = q->spare + size;
    for (int32_t y = 0; y < height; y++) {
        const int32_t from = r.x0 - TAIL, at = imin(imax(r.y0 - TAIL + y, 0), p->height - 1);
        const float *pixels = p->pixels + (size_t)at * (size_t)p->width;
        for (int32_t x = 0; x < width; x++) out[(size_t)y * row + (size_t)x] = pixels[imin(imax(from + x, 0), p->width - 1)];
    }
    through(out, size - 2 * TAIL * row, row, down);
    through(down, size - 2 * TAIL * row - 2 * TAIL, 1, out);
    q->plane = (cc_plane){out, width, height - 2 * TAIL}, q->x = r.x0, q->y = r.y0;
    return 1;
}

/* The pixels that a template's points, in the box, are read from at a pose, and so many more. */
static rect read_at(const cc_register *task, const box *points, const double pose[4], int32_t more) {
    const double c = pose[3] * cos(pose[2]), s = pose[3] * sin(pose[2]);
    const double right = task->plane.width - 1, bottom = task->plane.height - 1;
    double x0 = right, x1 = 0, y0 = bottom, y1 = 0;
    for (int k = 0; k < 4; k++) {
        const double u = k & 1 ? points->x1 : points->x0, v = k & 2 ? points->y1 : points->y0;
        const double x = lower(upper(pose[0] + c * u - s * v, 0), right);
        const double y = lower(upper(pose[1] + s * u + c * v, 0), bottom);
        x0 = lower(x0, x), x1 = upper(x1, x), y0 = lower(y0, y), y1 = upper(y1, y);
    }
    return (rect){imax((int32_t)x0 - 1 - more, -1), imin((int32_t)x1 + 2 + more, task->plane.width),
                  imax((int32_t)y0 - 1 - more, -1), imin((int32_t)y1 + 2 + more, task->plane.height)};
}

/* See to it that a part holds what is read at a pose; 0 where memory is short. */
static int seen_to(const cc_register *task, const box *points, const double pose[4], part *q) {
    if (!task->cubic) return 1;
    const rect r = read_at(task, points, pose, 1); /* 1: poses are rounded to single precision */
    const int32_t right = q->x + q->plane.width - 2 * TAIL - 1, bottom = q->y + q->plane.height - 1;
    if (q->capacity && r.x0 >= q->x && r.x1 <= right && r.y0 >= q->y && r.y1 <= bottom) return 1;
    return fitted(&task->plane, read_at(task, points, pose, ROOM), q);
}

/* Sums over the picture g under the template: of g, g^2, g value, g slope. */
typedef struct { double one, two, value, slope[4]; } sums;

static sums sums_at(const cc_register *r, const part *q, const double pose[4]) {
    const float c = (float)(pose[3] * cos(pose[2])), s = (float)(pose[3] * sin(pose[2]));
    const f8 x0 = eight((float)(pose[0] - q->x)), y0 = eight((float)(pose[1] - q->y));
    const float short_of = 1 - FLT_EPSILON; /* the last pixel: between it and the one before */
    const f8 left = eight((float)-q->x), right = eight((float)(r->plane.width - 1 - q->x) * short_of);
    const f8 top = eight((float)-q->y), bottom = eight((float)(r->plane.height - 1 - q->y) * short_of);
    const f8 mean = eight(r->plane.pixels[0]); /* subtracted first: less cancellation in the sums of squares */
    f8 one = eight(0), two = one, value = one, slope[4] = {one, one, one, one};
    for (int32_t k = 0; k < r->n; k += 8) { /* the caller fills up to a multiple of 8, with zeros in all but count */
        const f8 u = load(r->u + k), v = load(r->v + k);
        const f8 x = most_of(least_of(x0 + c * u - s * v, right), left);
        const f8 y = most_of(least_of(y0 + s * u + c * v, bottom), top);
        f8 g = (r->cubic ? cubic(&q->plane, x, y) : bilinear(&q->plane, x, y)) - mean;
        if (k + 8 > r->n) {
            const i8 number = *(const i8 *)LANE;
            g = choose(number < r->n - k, g, eight(0));
        }
        one += g, two = fused(g, g, two), value = fused(g, load(r->value + k), value);
        for (int m = 0; m < r->motions; m++)
            slope[m] = fused(g, load(r->slope + (size_t)m * (size_t)((r->n + 7) / 8 * 8) + k), slope[m]);
    }
    sums out = {.one = sum(one), .two = sum(two), .value = sum(value)};
    for (int m = 0; m < r->motions; m++) out.slope[m] = sum(slope[m]);
    return out;
}

static double score_of(const cc_register *r, const sums *s) {
    const double square = s->two - s->one * s->one / r->n;
    return square > 1e-12 * r->n ? s->value / sqrt(square) : 0;
}

/* Move a pose by the inverse of the template's motion `step`. Returns how far (px) a point moves, at most. */
static double moved(double pose[4], const double step[4], double radius) {
    const double turn = pose[2] - step[2], scale = pose[3] * exp(-step[3]);
    const double c = scale * cos(turn), s = scale * sin(turn);
    pose[0] -= c * step[0] - s * step[1], pose[1] -= s * step[0] + c * step[1];
    pose[2] = turn, pose[3] = scale;
    return scale * (hypot(step[0], step[1]) + radius * (fabs(step[2]) + fabs(step[3])));
}

/* Climb to the peak near a pose; its score. -1: memory is short. */
static int climb(const cc_register *r, const box *points, part *q, double pose[4], double *score) {
    const double start[2] = {pose[0], pose[1]}, scale = pose[3];
    double far = INFINITY;
    for (int32_t i = 0;; i++) {
        if (!seen_to(r, points, pose, q)) return -1;
        const sums s = sums_at(r, q, pose);
        *score = score_of(r, &s);
        if (i == r->iterations || far < r->settled || fabs(s.value) < 1e-12) return 0;
        double step[4] = {0, 0, 0, 0};
        for (int m = 0; m < r->motions; m++)
            for (int k = 0; k < r->motions; k++) step[m] += r->inverse[m * r->motions + k] * s.slope[k] / s.value;
        far = moved(pose, step, r->radius), *score = 0;
        if (!(hypot(pose[0] - start[0], pose[1] - start[1]) < r->reach) || !(fabs(log(pose[3] / scale)) < 0.4))
            return 0;
    }
}

int32_t VARIANT(register_poses)(const cc_register *r, double *pose, double *score, int32_t count) {
    box points = {0, 0, 0, 0}; /* with the origin, where the numbers lie that fill up to a multiple of 8 */
    for (int32_t k = 0; k < r->n; k++) {
        points.x0 = lower(points.x0, r->u[k]), points.x1 = upper(points.x1, r->u[k]);
        points.y0 = lower(points.y0, r->v[k]), points.y1 = upper(points.y1, r->v[k]);
    }
    part q = {.plane = r->plane};
    int32_t fine = 0;
    for (int32_t i = 0; i < count && !fine; i++) fine = climb(r, &points, &q, pose + 4 * (size_t)i, score + i);
    free(q.spare);
    return fine;
}
