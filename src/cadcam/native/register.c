/* The climb to the sub-pixel peak (inverse compositional Gauss-Newton on the normalised correlation), and what pulls at
 * it. Compiled once for each instruction set. */
#include "correlate.h"
#include "hot.h"
#include "vectors.h"

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
static float sum(f8 v) {
    float s = 0;
    for (int k = 0; k < 8; k++) s += v[k];
    return s;
}

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

/* The same with its slopes by x and y. */
INLINE f8 cubic_slopes(const cc_plane *p, f8 x, f8 y, f8 *right, f8 *down) {
    const i8 i = whole_f(x), j = whole_f(y), at = (j - 1) * p->width + (i - 1);
    const f8 tx = x - real(i), ty = y - real(j), rx = 1.0f - tx, ry = 1.0f - ty;
    const f8 dx[4] = {-0.5f * rx * rx, tx * (1.5f * tx - 2.0f), rx * (2.0f - 1.5f * rx), 0.5f * tx * tx};
    const f8 dy[4] = {-0.5f * ry * ry, ty * (1.5f * ty - 2.0f), ry * (2.0f - 1.5f * ry), 0.5f * ty * ty};
    f8 wx[4], wy[4], s = eight(0);
    cubic_weights(tx, wx), cubic_weights(ty, wy), *right = *down = s;
    const float *row[8];
    for (int k = 0; k < 8; k++) row[k] = p->pixels + at[k];
    for (int l = 0; l < 4; l++) {
        f8 column[4], here = eight(0), slope = here;
        transposed(row, column);
        for (int k = 0; k < 4; k++) here = fused(wx[k], column[k], here), slope = fused(dx[k], column[k], slope);
        s = fused(wy[l], here, s), *down = fused(dy[l], here, *down), *right = fused(wy[l], slope, *right);
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

/* Fit the spline to a part of the picture, beyond whose border its last pixels are repeated; 0: memory is short. */
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
        float *to = out + (size_t)y * row;
        for (int32_t x = 0; x < width; x++) to[x] = pixels[imin(imax(from + x, 0), p->width - 1)];
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

/* Where points are read at a pose: in pixels of a part, and within what of it. */
typedef struct { f8 x, y, c, s, left, right, top, bottom; } reading;

static reading reading_at(const cc_register *r, const part *q, const double pose[4]) {
    const float short_of = 1 - FLT_EPSILON; /* the last pixel: between it and the one before */
    const float right = (float)(r->plane.width - 1 - q->x), bottom = (float)(r->plane.height - 1 - q->y);
    return (reading){
        eight((float)(pose[0] - q->x)),
        eight((float)(pose[1] - q->y)),
        eight((float)(pose[3] * cos(pose[2]))),
        eight((float)(pose[3] * sin(pose[2]))),
        eight((float)-q->x),
        eight(right * short_of),
        eight((float)-q->y),
        eight(bottom * short_of),
    };
}

INLINE void place_eight(const reading *at, f8 u, f8 v, f8 *x, f8 *y) {
    *x = most_of(least_of(at->x + at->c * u - at->s * v, at->right), at->left);
    *y = most_of(least_of(at->y + at->s * u + at->c * v, at->bottom), at->top);
}

/* The picture at eight points from number k on, less a level; 0 beyond the last. */
INLINE f8 read_eight(const cc_register *r, const part *q, const reading *at, int32_t k, f8 level) {
    f8 x, y;
    place_eight(at, load(r->u + k), load(r->v + k), &x, &y);
    const f8 g = (r->cubic ? cubic(&q->plane, x, y) : bilinear(&q->plane, x, y)) - level;
    return k + 8 > r->n ? choose(*(const i8 *)LANE < r->n - k, g, eight(0)) : g;
}

/* The slopes by motion m at eight points: the caller fills them up to a multiple of 8. */
INLINE f8 slopes_of(const cc_register *r, int m, int32_t k) {
    return load(r->slope + (size_t)m * (size_t)((r->n + 7) / 8 * 8) + k);
}

/* Sums over the picture g, less its first pixel's, under the template: of g, g^2, g value, g slope. */
typedef struct { double one, two, value, slope[4]; } sums;

static sums sums_at(const cc_register *r, const part *q, const double pose[4]) {
    const reading at = reading_at(r, q, pose);
    const f8 level = eight(r->plane.pixels[0]); /* subtracted first: less cancellation in the sums of squares */
    f8 one = eight(0), two = one, value = one, slope[4] = {one, one, one, one};
    for (int32_t k = 0; k < r->n; k += 8) {
        const f8 g = read_eight(r, q, &at, k, level);
        one += g, two = fused(g, g, two), value = fused(g, load(r->value + k), value);
        for (int m = 0; m < r->motions; m++) slope[m] = fused(g, slopes_of(r, m, k), slope[m]);
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

/* The extent of the points and the origin, where those lie that fill up to a multiple of 8. */
static box extent_of(const cc_register *r) {
    box b = {0, 0, 0, 0};
    for (int32_t k = 0; k < r->n; k++) {
        b.x0 = lower(b.x0, r->u[k]), b.x1 = upper(b.x1, r->u[k]);
        b.y0 = lower(b.y0, r->v[k]), b.y1 = upper(b.y1, r->v[k]);
    }
    return b;
}

int32_t VARIANT(register_poses)(const cc_register *r, double *pose, double *score, int32_t count) {
    const box points = extent_of(r);
    part q = {.plane = r->plane};
    int32_t short_of_memory = 0;
    for (int32_t i = 0; i < count && !short_of_memory; i++)
        short_of_memory = climb(r, &points, &q, pose + 4 * (size_t)i, score + i);
    free(q.spare);
    return short_of_memory;
}

/* By each motion, the pull of each point: its slope times what the template does not explain there. The first point
 * lies side - 1 px right of and below the corner. */
typedef struct {
    float *pull; /* (motions, size): rows of `wide` */
    size_t size, wide, side;
} pulls;

/* Read the picture g at a pose, less its first pixel's, and `shown` (motions, motions): slopes times those of g, at the
 * gain that g value is returned as. */
static double read_all(const cc_register *r, const part *q, const double pose[4], float *g, double *shown) {
    const reading at = reading_at(r, q, pose);
    const f8 level = eight(r->plane.pixels[0]);
    f8 both[4][4] = {{eight(0)}}, value = eight(0);
    for (int32_t k = 0; k < r->n; k += 8) {
        const f8 u = load(r->u + k), v = load(r->v + k);
        f8 x, y, right, down;
        place_eight(&at, u, v, &x, &y);
        const f8 here = cubic_slopes(&q->plane, x, y, &right, &down) - level;
        const f8 gu = at.c * right + at.s * down, gv = at.c * down - at.s * right;
        const f8 seen[4] = {gu, gv, gv * u - gu * v, gu * u + gv * v};
        for (int m = 0; m < r->motions; m++)
            for (int i = 0; i < r->motions; i++) both[m][i] = fused(slopes_of(r, m, k), seen[i], both[m][i]);
        *(f8 *)(g + k) = here, value = fused(here, load(r->value + k), value);
    }
    const double gain = sum(value), inverse = fabs(gain) < 1e-12 ? 0 : 1 / gain;
    for (int m = 0; m < r->motions; m++)
        for (int i = 0; i < r->motions; i++) *shown++ = sum(both[m][i]) * inverse;
    return inverse;
}

/* Fill the fields with what is read, at the inverse of its gain. */
static void fill(const cc_register *r, const box *points, const float *g, double inverse, const pulls *f) {
    double all = 0;
    for (int32_t k = 0; k < r->n; k++) all += g[k];
    const f8 x0 = eight((float)points->x0), y0 = eight((float)points->y0);
    const f8 mean = eight((float)(all / r->n)), by = eight((float)inverse);
    const int32_t first = (int32_t)f->side - 1;
    memset(f->pull, 0, (size_t)r->motions * f->size * sizeof *f->pull);
    for (int32_t k = 0; k < r->n; k += 8) {
        const f8 unexplained = (load(g + k) - mean) * by - load(r->value + k);
        const i8 column = whole_f(load(r->u + k) - x0 + 0.5f), line = whole_f(load(r->v + k) - y0 + 0.5f);
        const i8 to = (line + first) * (int32_t)f->wide + column + first;
        for (int m = 0; m < r->motions; m++) {
            const f8 pull = unexplained * slopes_of(r, m, k);
            for (int i = 0; i < imin(8, r->n - k); i++) f->pull[(size_t)m * f->size + (size_t)to[i]] = pull[i];
        }
    }
}

/* To each pixel, those of the square that it is the first of, along its rows or, `row` apart, its columns. */
static void add_up(float *a, const pulls *f, size_t row) {
    for (size_t step = 1; step < f->side; step *= 2)
        for (size_t i = 0; i + step * row + 8 <= f->size; i += 8)
            *(f8 *)(a + i) = load(a + i) + load(a + i + step * row);
}

int32_t VARIANT(register_pulls)(const cc_register *r, int32_t side, const double *pose, double *moment, double *shown,
                                int32_t count) {
    const box points = extent_of(r);
    pulls f = {.wide = (size_t)(points.x1 - points.x0 + side) + 1, .side = (size_t)side};
    f.size = (f.wide * ((size_t)(points.y1 - points.y0 + 2 * side) + 1) + 15) / 8 * 8;
    f.pull = malloc((size_t)r->motions * f.size * sizeof *f.pull);
    float *g = malloc(((size_t)r->n + 8) * sizeof *g);
    part q = {.plane = r->plane};
    int fine = f.pull && g;
    for (int32_t i = 0; i < count && fine; i++, pose += 4) {
        if (!(fine = seen_to(r, &points, pose, &q))) break;
        fill(r, &points, g, read_all(r, &q, pose, g, shown), &f), shown += r->motions * r->motions;
        for (int m = 0; m < r->motions; m++)
            add_up(f.pull + m * f.size, &f, 1), add_up(f.pull + m * f.size, &f, f.wide);
        for (int m = 0; m < r->motions; m++)
            for (int k = 0; k <= m; k++) {
                const float *a = f.pull + m * f.size, *b = f.pull + k * f.size;
                f8 product = eight(0);
                for (size_t p = 0; p < f.size; p += 8) product = fused(load(a + p), load(b + p), product);
                moment[m * r->motions + k] = moment[k * r->motions + m] = (double)sum(product) / (side * side);
            }
        moment += r->motions * r->motions;
    }
    free(f.pull), free(g), free(q.spare);
    return fine ? 0 : -1;
}
