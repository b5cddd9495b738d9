/* The hot file, compiled once for each instruction set (CC_VARIANT is the suffix of its two functions).
 *
 * Homogeneous rasterisation (Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997): with
 * the corners P_i of a triangle in the homogeneous sampling plane, e_0(q) = q . (P_1 x P_2) and its like are linear in the
 * plane point q = (x, y, 1), have one sign inside the triangle's visible part, and 1/z = q . N / (P_0 . N) with N the
 * triangle's normal there. Nothing is divided by z, so triangles that reach behind the camera need no clipping.
 * q is a pixel, or the undistorted point that a pixel of a distorting camera looks at: the same code draws both.
 *
 * Coverage. All of it is in double. A cross product changes its sign exactly when its factors change places, and
 * A x + (B y + C) exactly when A, B, C do (no fused multiply-adds: -ffp-contract=off): two triangles that share an edge
 * never both take, nor both miss, a point of it. Points with e = 0 belong to the triangle on the right of the edge, or
 * below it (the top-left rule).
 *
 * Depth. 1/z is evaluated in double, rounded to float, and kept within that of the corners. The nearest wins, and among
 * equals the lowest face number: the picture does not depend on the order of drawing, nor on the number of threads.
 *
 * Culling. Every bound used to skip work is evaluated with the same monotone operations as the value that it bounds, or
 * widened: it can cost time, never a sample. */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "internal.h"

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)
#define VARIANT(name) JOIN(name, CC_VARIANT)

static inline double lower(double a, double b) { return a < b ? a : b; }
static inline double upper(double a, double b) { return a > b ? a : b; }
static inline double lower3(double a, double b, double c) { return lower(lower(a, b), c); }
static inline double upper3(double a, double b, double c) { return upper(upper(a, b), c); }
static inline int32_t imin(int32_t a, int32_t b) { return a < b ? a : b; }
static inline int32_t imax(int32_t a, int32_t b) { return a > b ? a : b; }

/* A float that is at least (at most) v, for bounds of 1/z. */
static inline float float_above(double v) { return v < FLT_MAX / 2 ? (float)(v * (1 + 1e-6)) : FLT_MAX; }

/* ---- where things may lie ------------------------------------------------------------------------------------ */

/* Samples whose centre lies in the box [x0, x1] x [y0, y1] of the plane (pixels) or of the lens' cells. */
static inline rect samples_of(const cc_frame *f, box b) {
    if (f->view->lens) {
        const double slack = 1e-6;
        return lens_samples(f->view->lens, (box){b.x0 - slack, b.x1 + slack, b.y0 - slack, b.y1 + slack});
    }
    const double slack = 1e-5; /* px: far above rounding */
    double x0 = ceil(upper(b.x0 - slack, 0)), x1 = floor(lower(b.x1 + slack, f->width - 1));
    double y0 = ceil(upper(b.y0 - slack, 0)), y1 = floor(lower(b.y1 + slack, f->height - 1));
    if (!(x0 <= x1 && y0 <= y1)) return (rect){1, 0, 1, 0};
    return (rect){(int32_t)x0, (int32_t)x1, (int32_t)y0, (int32_t)y1};
}

/* Whether n points all lie beyond one side of the picture (homogeneous, so true of points behind the camera too). */
static inline int beyond_a_side(const box *l, const double *x, const double *y, const double *z, const uint8_t *i, int n) {
    int left = 1, right = 1, above = 1, below = 1, behind = 1;
    for (int k = 0; k < n; k++) {
        double px = x[i[k]], py = y[i[k]], pz = z[i[k]];
        left &= px < l->x0 * pz, right &= px > l->x1 * pz;
        above &= py < l->y0 * pz, below &= py > l->y1 * pz;
        behind &= pz <= 0;
    }
    return left | right | above | below | behind;
}

/* Coordinates in which boxes are taken: pixels, or cells of the lens' table. */
static inline double grid_x(const cc_lens *l, double u) { return l ? (squash(u) - l->origin_x) * l->scale_x : u; }
static inline double grid_y(const cc_lens *l, double v) { return l ? (squash(v) - l->origin_y) * l->scale_y : v; }

static int locate_cluster(const cc_frame *f, const cluster *c, candidate *out, double *nearest_z) {
    static const uint8_t all[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    const double *M = f->view->plane;
    const cc_lens *lens = f->view->lens;
    double x[8], y[8], z[8];
    box b = {INFINITY, -INFINITY, INFINITY, -INFINITY};
    double z0 = INFINITY, z1 = -INFINITY;
    for (int k = 0; k < 8; k++) {
        double X = k & 1 ? c->high[0] : c->low[0], Y = k & 2 ? c->high[1] : c->low[1], Z = k & 4 ? c->high[2] : c->low[2];
        x[k] = M[0] * X + M[1] * Y + M[2] * Z + M[3];
        y[k] = M[4] * X + M[5] * Y + M[6] * Z + M[7];
        z[k] = M[8] * X + M[9] * Y + M[10] * Z + M[11];
    }
    for (int k = 0; k < 8; k++) z0 = lower(z0, z[k]), z1 = upper(z1, z[k]);
    double size = upper(fabs(z0), fabs(z1));
    *nearest_z = z0 = z0 - 1e-9 * size; /* the box' corners are rounded: stay on the safe side */
    if (z1 + 1e-9 * size <= 0 || beyond_a_side(&f->limits, x, y, z, all, 8)) return 0;
    if (!(z0 > 1e-6 * size)) { /* reaches (nearly) behind the camera */
        out->where = (rect){0, f->width - 1, 0, f->height - 1};
        out->nearest = INFINITY;
        return 1;
    }
    for (int k = 0; k < 8; k++) {
        double gx = grid_x(lens, x[k] / z[k]), gy = grid_y(lens, y[k] / z[k]);
        b.x0 = lower(b.x0, gx), b.x1 = upper(b.x1, gx), b.y0 = lower(b.y0, gy), b.y1 = upper(b.y1, gy);
    }
    out->where = samples_of(f, (box){b.x0 - 1e-3, b.x1 + 1e-3, b.y0 - 1e-3, b.y1 + 1e-3});
    out->nearest = float_above(1 / z0);
    return out->where.x0 <= out->where.x1 && out->where.y0 <= out->where.y1;
}

/* Nearest first, roughly: a counting sort over 4096 steps of depth, enough for hidden clusters to come last. */
static int sort_by_depth(cc_frame *f, double *depth) {
    enum { STEPS = 4096 };
    uint32_t at[STEPS + 1] = {0};
    size_t n = (size_t)f->n_candidates;
    candidate *sorted = malloc((n + 1) * sizeof *sorted);
    if (!sorted) return 0;
    double low = INFINITY, high = -INFINITY;
    for (size_t i = 0; i < n; i++) depth[i] = upper(depth[i], 0), low = lower(low, depth[i]), high = upper(high, depth[i]);
    double scale = high > low ? (STEPS - 1) / (high - low) : 0;
    if (!(scale < INFINITY)) scale = 0;
    for (size_t i = 0; i < n; i++) at[(uint32_t)((depth[i] - low) * scale) + 1]++;
    for (int k = 0; k < STEPS; k++) at[k + 1] += at[k];
    for (size_t i = 0; i < n; i++) sorted[at[(uint32_t)((depth[i] - low) * scale)]++] = f->candidates[i];
    free(f->candidates);
    f->candidates = sorted;
    return 1;
}

int VARIANT(frame_prepare)(cc_frame *f) {
    const cc_scene *s = f->scene;
    if (f->view->lens) {
        box a = f->view->lens->all;
        double mx = 1e-6 * (fabs(a.x0) + fabs(a.x1)), my = 1e-6 * (fabs(a.y0) + fabs(a.y1));
        f->limits = (box){a.x0 - mx, a.x1 + mx, a.y0 - my, a.y1 + my};
        if (!(a.x0 <= a.x1)) return 1; /* no pixel sees anything */
    } else
        f->limits = (box){-0.5, f->width - 0.5, -0.5, f->height - 0.5};
    double *depth = malloc(((size_t)s->n_clusters + 1) * sizeof *depth);
    if (!depth) return 0;
    for (int64_t i = 0; i < s->n_clusters; i++) {
        candidate *c = &f->candidates[f->n_candidates];
        c->index = (uint32_t)i;
        if (locate_cluster(f, &s->clusters[i], c, &depth[f->n_candidates])) f->n_candidates++;
    }
    int sorted = sort_by_depth(f, depth);
    free(depth);
    return sorted;
}

/* ---- drawing -------------------------------------------------------------------------------------------------- */

/* The part of the picture that a worker draws at a time. */
typedef struct {
    const cc_frame *frame;
    cc_worker *worker;
    int32_t y0, y1;      /* samples, both included */
    int32_t first_tiles; /* row of tiles at the top */
} band;

/* A cluster's vertices in the sampling plane: homogeneous, in grid coordinates (NaN or worse behind the camera), 1/z. */
typedef struct {
    _Alignas(64) double x[CORNERS];
    _Alignas(64) double y[CORNERS];
    _Alignas(64) double z[CORNERS];
    _Alignas(64) double gx[CORNERS];
    _Alignas(64) double gy[CORNERS];
    _Alignas(64) double w[CORNERS];
} corners;

/* A triangle ready to draw: three edges (inside: a x + (b y + c) >= least) and, last, the plane of 1/z. */
typedef struct {
    double a[4], b[4], c[4];
    double least[3];
    float nearest, farthest; /* bounds of 1/z: those of its corners */
    int32_t id;
} triangle;

static void transform(const cc_frame *f, const cluster *c, corners *out) {
    const double *restrict X = f->scene->x + c->first_vertex, *restrict Y = f->scene->y + c->first_vertex;
    const double *restrict Z = f->scene->z + c->first_vertex;
    const double *M = f->view->plane;
    int n = c->n_vertices;
    for (int i = 0; i < n; i++) {
        out->x[i] = M[0] * X[i] + M[1] * Y[i] + M[2] * Z[i] + M[3];
        out->y[i] = M[4] * X[i] + M[5] * Y[i] + M[6] * Z[i] + M[7];
        out->z[i] = M[8] * X[i] + M[9] * Y[i] + M[10] * Z[i] + M[11];
    }
    for (int i = 0; i < n; i++) {
        double w = 1.0 / out->z[i];
        out->w[i] = w, out->gx[i] = out->x[i] * w, out->gy[i] = out->y[i] * w;
    }
    const cc_lens *lens = f->view->lens;
    if (lens)
        for (int i = 0; i < n; i++) out->gx[i] = grid_x(lens, out->gx[i]), out->gy[i] = grid_y(lens, out->gy[i]);
}

static inline void cross(const double p[3], const double q[3], double out[3]) {
    out[0] = p[1] * q[2] - p[2] * q[1];
    out[1] = p[2] * q[0] - p[0] * q[2];
    out[2] = p[0] * q[1] - p[1] * q[0];
}

/* Edges and plane of a triangle; 0 where it is seen edge-on or has no area. */
static inline int set_up(const corners *v, const uint8_t *i, triangle *t) {
    double P[3][3], d1[3], d2[3], n[3], e[3];
    for (int k = 0; k < 3; k++) P[k][0] = v->x[i[k]], P[k][1] = v->y[i[k]], P[k][2] = v->z[i[k]];
    for (int k = 0; k < 3; k++) d1[k] = P[1][k] - P[0][k], d2[k] = P[2][k] - P[0][k];
    cross(d1, d2, n);
    double det = n[0] * P[0][0] + n[1] * P[0][1] + n[2] * P[0][2];
    double inverse = 1.0 / det, sign = det < 0 ? -1.0 : 1.0;
    if (!(fabs(det) > 0 && fabs(inverse) <= DBL_MAX && fabs(det) <= DBL_MAX)) return 0;
    for (int k = 0; k < 3; k++) {
        cross(P[(k + 1) % 3], P[(k + 2) % 3], e);
        t->a[k] = e[0] * sign, t->b[k] = e[1] * sign, t->c[k] = e[2] * sign;
        /* e = 0 counts on the left and top edges; elsewhere e must be positive */
        t->least[k] = t->a[k] > 0 || (t->a[k] == 0 && t->b[k] > 0) ? 0.0 : DBL_MIN;
    }
    t->a[3] = n[0] * inverse, t->b[3] = n[1] * inverse, t->c[3] = n[2] * inverse;
    return 1;
}

/* The largest and smallest value over a box of linear function k of a triangle. */
static inline double most(const triangle *t, int k, const box *b) {
    return t->a[k] * (t->a[k] > 0 ? b->x1 : b->x0) + (t->b[k] * (t->b[k] > 0 ? b->y1 : b->y0) + t->c[k]);
}
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
static inline void draw_points(const triangle *t, const double *restrict x, const double *restrict y, int top, int end,
                               int whole, float *restrict z, int32_t *restrict id) {
    const double near = t->nearest, far = t->farthest;
    const int32_t face = t->id;
    for (int k = top; k <= end; k++) {
        for (int i = k * TILE; i < k * TILE + TILE; i++) {
            double w = t->a[3] * x[i] + (t->b[3] * y[i] + t->c[3]);
            w = w < near ? w : near;
            w = w > far ? w : far;
            int inside = whole ? x[i] == x[i]
                               : (t->a[0] * x[i] + (t->b[0] * y[i] + t->c[0]) >= t->least[0]) &
                                     (t->a[1] * x[i] + (t->b[1] * y[i] + t->c[1]) >= t->least[1]) &
                                     (t->a[2] * x[i] + (t->b[2] * y[i] + t->c[2]) >= t->least[2]);
            keep((float)(inside ? w : -1.0), face, &z[i], &id[i]);
        }
    }
}

static void measure_tile(cc_worker *w, size_t tile) {
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

/* Where in the plane the samples of a block of 2^level x 2^level tiles lie that are in the triangle's rectangle. */
static inline box area_of(const cc_frame *f, const rect *r, int level, int32_t bx, int32_t by) {
    if (f->view->lens) {
        int32_t wide = (f->tiles_x + (1 << level) - 1) >> level;
        return f->view->lens->block[level][(size_t)by * (size_t)wide + (size_t)bx];
    }
    int32_t size = TILE << level;
    return (box){imax(bx * size, r->x0), imin(bx * size + size - 1, r->x1), imax(by * size, r->y0),
                 imin(by * size + size - 1, r->y1)};
}

static inline int misses(const triangle *t, const box *area) {
    return (most(t, 0, area) < 0) | (most(t, 1, area) < 0) | (most(t, 2, area) < 0);
}

static inline int contains(const triangle *t, const box *area) {
    return (fewest(t, 0, area) > DBL_MIN) & (fewest(t, 1, area) > DBL_MIN) & (fewest(t, 2, area) > DBL_MIN);
}

/* Draw into one tile; `small` triangles, of few rows in one tile, are not worth the tests. */
static inline void draw_tile(const band *b, const triangle *t, const rect *r, int32_t tx, int32_t ty, int small) {
    const cc_frame *f = b->frame;
    cc_worker *w = b->worker;
    const cc_lens *lens = f->view->lens;
    size_t tile = (size_t)(ty - b->first_tiles) * (size_t)f->tiles_x + (size_t)tx;
    size_t of_lens = (size_t)ty * (size_t)f->tiles_x + (size_t)tx;
    int whole = 0, top = imax(r->y0 - ty * TILE, 0), end = imin(r->y1 - ty * TILE, TILE - 1);
    if (t->nearest < w->farthest[tile]) return;
    if (!small) {
        box area = area_of(f, r, 0, tx, ty);
        if (misses(t, &area)) return;
        if ((float)most(t, 3, &area) < w->farthest[tile] && t->farthest < w->farthest[tile]) return;
        int fits = r->x0 <= tx * TILE && r->x1 >= tx * TILE + TILE - 1 && end - top == TILE - 1;
        whole = fits && contains(t, &area);
    }
    float *z = w->inverse_z + tile * TILE_AREA;
    int32_t *id = w->id + tile * TILE_AREA;
    if (lens) {
        const double *x = lens->x + of_lens * TILE_AREA, *y = lens->y + of_lens * TILE_AREA;
        if (whole) draw_points(t, x, y, top, end, 1, z, id);
        else draw_points(t, x, y, top, end, 0, z, id);
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
    box area = area_of(b->frame, r, level, bx, by);
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

/* Whether a triangle of this nearness could be seen in some tile of the rectangle. */
static int may_be_seen(const band *b, const rect *r, float nearest) {
    const cc_frame *f = b->frame;
    for (int32_t ty = r->y0 / TILE; ty <= r->y1 / TILE; ty++) {
        const float *row = b->worker->farthest + (size_t)(ty - b->first_tiles) * (size_t)f->tiles_x;
        for (int32_t tx = r->x0 / TILE; tx <= r->x1 / TILE; tx++)
            if (!(nearest < row[tx])) return 1;
    }
    return 0;
}

/* The triangles of a cluster, side by side: bounds of their samples and of 1/z. */
typedef struct {
    _Alignas(64) double gx0[CLUSTER], gx1[CLUSTER], gy0[CLUSTER], gy1[CLUSTER];
    _Alignas(64) int32_t x0[CLUSTER], x1[CLUSTER], y0[CLUSTER], y1[CLUSTER];
    _Alignas(64) double front[CLUSTER]; /* smallest z: not positive where a corner lies behind the camera */
    _Alignas(64) float nearest[CLUSTER], farthest[CLUSTER];
} bounds;

static void bound(const cc_frame *f, const cluster *c, const corners *v, bounds *out) {
    const uint8_t *restrict c0 = f->scene->corner[0] + c->first_face, *restrict c1 = f->scene->corner[1] + c->first_face;
    const uint8_t *restrict c2 = f->scene->corner[2] + c->first_face;
    const double width = f->width, height = f->height, slack = 1e-5; /* px: far above rounding */
    int n = c->n_faces;
    for (int k = 0; k < n; k++) {
        int p = c0[k], q = c1[k], r = c2[k];
        double near = upper3(v->w[p], v->w[q], v->w[r]), far = lower3(v->w[p], v->w[q], v->w[r]);
        out->gx0[k] = lower3(v->gx[p], v->gx[q], v->gx[r]), out->gx1[k] = upper3(v->gx[p], v->gx[q], v->gx[r]);
        out->gy0[k] = lower3(v->gy[p], v->gy[q], v->gy[r]), out->gy1[k] = upper3(v->gy[p], v->gy[q], v->gy[r]);
        out->front[k] = lower3(v->z[p], v->z[q], v->z[r]);
        out->nearest[k] = (float)lower(near, FLT_MAX), out->farthest[k] = (float)lower(far, FLT_MAX);
    }
    if (f->view->lens) return;
    for (int k = 0; k < n; k++) { /* ceil and floor of numbers made at least 0 and -1: both vectorise everywhere */
        double x0 = lower(upper(out->gx0[k] - slack, 0), width), y0 = lower(upper(out->gy0[k] - slack, 0), height);
        double x1 = lower(upper(out->gx1[k] + slack, -1) + 1, width), y1 = lower(upper(out->gy1[k] + slack, -1) + 1, height);
        int32_t left = (int32_t)x0, top = (int32_t)y0;
        out->x0[k] = left + (x0 > left), out->y0[k] = top + (y0 > top);
        out->x1[k] = (int32_t)x1 - 1, out->y1[k] = (int32_t)y1 - 1;
    }
}

/* Which samples triangle k of a cluster may cover; empty where it is beyond a side of the picture. */
static inline rect reach(const cc_frame *f, const cluster *c, const corners *v, bounds *of, int k) {
    if (!(of->front[k] > 0)) { /* reaches behind the camera: anywhere, in front of its farthest corner */
        const uint8_t i[3] = {f->scene->corner[0][c->first_face + k], f->scene->corner[1][c->first_face + k],
                              f->scene->corner[2][c->first_face + k]};
        if (beyond_a_side(&f->limits, v->x, v->y, v->z, i, 3)) return (rect){1, 0, 1, 0};
        of->nearest[k] = FLT_MAX;
        of->farthest[k] = (float)lower(1 / upper3(v->z[i[0]], v->z[i[1]], v->z[i[2]]), FLT_MAX);
        return (rect){0, f->width - 1, 0, f->height - 1};
    }
    if (!f->view->lens) return (rect){of->x0[k], of->x1[k], of->y0[k], of->y1[k]};
    return samples_of(f, (box){of->gx0[k], of->gx1[k], of->gy0[k], of->gy1[k]});
}

static void draw_cluster(const band *b, const candidate *which) {
    const cc_frame *f = b->frame;
    const cluster *c = &f->scene->clusters[which->index];
    corners v;
    bounds of;
    transform(f, c, &v);
    bound(f, c, &v, &of);
    for (int k = 0; k < c->n_faces; k++) {
        rect r = reach(f, c, &v, &of, k);
        r.y0 = imax(r.y0, b->y0), r.y1 = imin(r.y1, b->y1);
        if (r.x0 > r.x1 || r.y0 > r.y1 || !may_be_seen(b, &r, of.nearest[k])) continue;
        size_t at = c->first_face + (size_t)k;
        const uint8_t i[3] = {f->scene->corner[0][at], f->scene->corner[1][at], f->scene->corner[2][at]};
        triangle t = {.nearest = of.nearest[k], .farthest = of.farthest[k], .id = f->scene->id[at]};
        if (set_up(&v, i, &t)) draw_triangle(b, &t, &r);
    }
}

/* ---- outputs -------------------------------------------------------------------------------------------------- */

/* What the shading of one output needs, in float: the direction of plane points and the light, in the world. */
typedef struct { float d[9], fill[3], ambient, head, strength; } light;

/* Eight samples of a row: what was met there, and from where. */
typedef struct {
    _Alignas(32) int32_t id[TILE];
    _Alignas(32) float d[3][TILE]; /* directions in the world, not of unit length */
    _Alignas(32) float n[3][TILE]; /* normals, as in the scene */
    _Alignas(32) float color[3][TILE]; /* of the parts; the background's where nothing was met */
    _Alignas(32) float along[TILE]; /* n . d: positive where the back is seen */
} eight;

static inline const float *normal_of(const cc_frame *f, int32_t id) { return f->scene->normal[id < 0 ? 0 : id]; }
static inline const float *color_of(const cc_frame *f, int32_t id) {
    return id < 0 ? f->view->background : f->scene->color[f->scene->part[id]];
}

static inline void look_up(const cc_frame *f, const light *l, int32_t tx, int32_t y, const int32_t *id, eight *e) {
    const cc_lens *lens = f->view->lens;
    const size_t at = ((size_t)(y / TILE) * (size_t)f->tiles_x + (size_t)tx) * TILE_AREA + (size_t)(y % TILE) * TILE;
    float px[TILE], py[TILE];
    for (int i = 0; i < TILE; i++) {
        px[i] = lens ? (float)lens->x[at + (size_t)i] : (float)(tx * TILE + i);
        py[i] = lens ? (float)lens->y[at + (size_t)i] : (float)y;
    }
    int same = 1;
    for (int i = 0; i < TILE; i++) same &= id[i] == id[0], e->id[i] = id[i];
    if (same) { /* the common case, and a fast one */
        const float *n = normal_of(f, id[0]), *color = color_of(f, id[0]);
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < TILE; i++) e->n[k][i] = n[k], e->color[k][i] = color[k];
    } else
        for (int i = 0; i < TILE; i++) {
            const float *n = normal_of(f, id[i]), *color = color_of(f, id[i]);
            for (int k = 0; k < 3; k++) e->n[k][i] = n[k], e->color[k][i] = color[k];
        }
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < TILE; i++) e->d[k][i] = l->d[3 * k] * px[i] + (l->d[3 * k + 1] * py[i] + l->d[3 * k + 2]);
    for (int i = 0; i < TILE; i++)
        e->along[i] = e->n[0][i] * e->d[0][i] + e->n[1][i] * e->d[1][i] + e->n[2][i] * e->d[2][i];
}

/* Matt, two-sided: ambient, a light at the camera, a distant one. */
static inline void shade(const light *l, const eight *e, float rgb[TILE][3]) {
    float value[TILE];
    for (int i = 0; i < TILE; i++) {
        float length = sqrtf(e->d[0][i] * e->d[0][i] + e->d[1][i] * e->d[1][i] + e->d[2][i] * e->d[2][i]);
        float fill = e->n[0][i] * l->fill[0] + e->n[1][i] * l->fill[1] + e->n[2][i] * l->fill[2];
        fill = e->along[i] > 0 ? -fill : fill; /* the side that faces the camera */
        value[i] = l->ambient + l->head * (fabsf(e->along[i]) / length) + l->strength * (fill > 0 ? fill : 0);
    }
    for (int i = 0; i < TILE; i++) value[i] = e->id[i] < 0 ? 1.0f : value[i];
    for (int i = 0; i < TILE; i++)
        for (int k = 0; k < 3; k++) {
            float c = e->color[k][i] * value[i];
            rgb[i][k] = c < 1 ? c : 1;
        }
}

/* Unit normals in the camera frame, turned towards the camera. */
static void face_camera(const cc_frame *f, const eight *e, float out[TILE][3]) {
    const double *R = f->view->rotation;
    for (int i = 0; i < TILE; i++)
        for (int k = 0; k < 3; k++) {
            double c = R[3 * k] * e->n[0][i] + R[3 * k + 1] * e->n[1][i] + R[3 * k + 2] * e->n[2][i];
            out[i][k] = e->id[i] < 0 ? 0.0f : (float)(e->along[i] > 0 ? -c : c);
        }
}

/* Copy the first n of eight items; a constant size is a few instructions, a variable one a call. */
static inline void put(void *to, const void *from, size_t n, size_t size) {
    if (n == TILE) memcpy(to, from, TILE * size);
    else memcpy(to, from, n * size);
}

static void write_eight(const cc_frame *f, const light *l, int32_t tx, int32_t y, const float *w, const int32_t *id) {
    const cc_view *v = f->view;
    const size_t n = (size_t)imin(TILE, f->width - tx * TILE), at = (size_t)y * (size_t)f->width + (size_t)tx * TILE;
    float number[TILE], triple[TILE][3];
    int32_t part[TILE];
    eight e;
    if (v->depth) {
        for (int i = 0; i < TILE; i++) {
            float z = 1.0f / w[i];
            number[i] = id[i] < 0 ? INFINITY : z;
        }
        put(v->depth + at, number, n, sizeof *number);
    }
    if (v->face) put(v->face + at, id, n, sizeof *id);
    if (v->part) {
        for (int i = 0; i < TILE; i++) part[i] = id[i] < 0 ? -1 : f->scene->part[id[i]];
        put(v->part + at, part, n, sizeof *part);
    }
    if (v->coverage) {
        for (int i = 0; i < TILE; i++) number[i] = (float)(id[i] >= 0);
        put(v->coverage + at, number, n, sizeof *number);
    }
    if (!v->image && !v->normal) return;
    look_up(f, l, tx, y, id, &e);
    if (v->image) {
        shade(l, &e, triple);
        put(v->image + 3 * at, triple, n, sizeof *triple);
    }
    if (v->normal) {
        face_camera(f, &e, triple);
        put(v->normal + 3 * at, triple, n, sizeof *triple);
    }
}

/* Add a row of samples to the sums (r, g, b, covered) of an output row. */
static void add_row(const cc_frame *f, const light *l, int32_t y, const int32_t *ids, float *sums) {
    float rgb[TILE][3];
    eight e;
    for (int32_t tx = 0; tx < f->tiles_x; tx++) {
        look_up(f, l, tx, y, ids + (size_t)tx * TILE_AREA, &e);
        shade(l, &e, rgb);
        for (int i = 0; i < imin(TILE, f->width - tx * TILE); i++) {
            float *sum = sums + 4 * (size_t)((tx * TILE + i) / f->view->samples);
            for (int k = 0; k < 3; k++) sum[k] += rgb[i][k];
            sum[3] += e.id[i] < 0 ? 0.0f : 1.0f;
        }
    }
}

static light light_of(const cc_view *v) {
    light l = {.ambient = v->ambient, .head = v->head, .strength = v->fill};
    for (int k = 0; k < 9; k++) l.d[k] = (float)v->ray[k];
    for (int k = 0; k < 3; k++) l.fill[k] = (float)v->fill_from[k];
    return l;
}

static void write_band(const band *b) {
    const cc_frame *f = b->frame;
    const cc_view *v = f->view;
    light l = light_of(v);
    float *sums = b->worker->row;
    int n = v->samples;
    for (int32_t y = b->y0; y <= b->y1; y++) {
        size_t at = (size_t)(y / TILE - b->first_tiles) * (size_t)f->tiles_x * TILE_AREA + (size_t)(y % TILE) * TILE;
        const float *w = b->worker->inverse_z + at;
        const int32_t *id = b->worker->id + at;
        if (n == 1) {
            for (int32_t tx = 0; tx < f->tiles_x; tx++)
                write_eight(f, &l, tx, y, w + (size_t)tx * TILE_AREA, id + (size_t)tx * TILE_AREA);
            continue;
        }
        if (y % n == 0) memset(sums, 0, (size_t)v->width * 4 * sizeof *sums);
        add_row(f, &l, y, id, sums);
        if (y % n < n - 1) continue;
        size_t row = (size_t)(y / n) * (size_t)v->width;
        float scale = 1.0f / (float)(n * n);
        for (int32_t x = 0; x < v->width; x++) {
            if (v->image)
                for (int k = 0; k < 3; k++) v->image[3 * (row + (size_t)x) + k] = sums[4 * (size_t)x + k] * scale;
            if (v->coverage) v->coverage[row + (size_t)x] = sums[4 * (size_t)x + 3] * scale;
        }
    }
}

/* ---- bands ---------------------------------------------------------------------------------------------------- */

static void clear_band(const band *b, size_t tiles) {
    cc_worker *w = b->worker;
    const cc_frame *f = b->frame;
    memset(w->inverse_z, 0, tiles * TILE_AREA * sizeof(float));
    memset(w->id, 0xFF, tiles * TILE_AREA * sizeof(int32_t));
    memset(w->farthest, 0, tiles * sizeof(float));
    memset(w->changes, 0, tiles);
    if (!f->view->lens) return;
    for (size_t t = 0; t < tiles; t++) { /* samples without a direction must not keep their tile open */
        size_t of_lens = t + (size_t)b->first_tiles * (size_t)f->tiles_x;
        if (!f->view->lens->partial[of_lens]) continue;
        for (int k = 0; k < TILE_AREA; k++)
            if (isnan(f->view->lens->x[of_lens * TILE_AREA + k])) w->inverse_z[t * TILE_AREA + k] = FLT_MAX;
    }
}

int VARIANT(frame_work)(cc_frame *f, cc_worker *worker) {
    for (;;) {
        int32_t first = atomic_fetch_add(&f->next_band, 1) * f->band_rows;
        if (first >= f->tiles_y) return 0;
        int32_t rows = imin(f->band_rows, f->tiles_y - first);
        size_t tiles = (size_t)rows * (size_t)f->tiles_x;
        if (!worker_reserve(worker, tiles, (size_t)f->view->width * 4)) return -1;
        band b = {f, worker, first * TILE, imin((first + rows) * TILE, f->height) - 1, first};
        clear_band(&b, tiles);
        for (int64_t i = 0; i < f->n_candidates; i++) {
            const candidate *c = &f->candidates[i];
            rect r = {c->where.x0, c->where.x1, imax(c->where.y0, b.y0), imin(c->where.y1, b.y1)};
            if (r.y0 <= r.y1 && may_be_seen(&b, &r, c->nearest)) draw_cluster(&b, c);
        }
        write_band(&b);
    }
}
