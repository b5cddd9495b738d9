/* From clusters to triangles ready to draw, band by band.
 *
 * Homogeneous rasterisation (Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997): with
 * the corners P_i of a triangle in the homogeneous sampling plane, e_0(q) = q . (P_1 x P_2) and its like are linear in the
 * plane point q = (x, y, 1), have one sign inside the triangle's visible part, and 1/z = q . N / (P_0 . N) with N the
 * triangle's normal there. Nothing is divided by z, so triangles that reach behind the camera need no clipping.
 * q is a pixel, or the undistorted point that a pixel of a distorting camera looks at: the same code draws both.
 *
 * Coverage is defined in double (strip.c says how it is decided without looking at every sample). A cross product
 * changes its sign exactly when its factors change places, and A x + (B y + C) exactly when A, B, C do (no fused
 * multiply-adds: -ffp-contract=off): two triangles that share an edge never both take, nor both miss, a point of it.
 * Points with e = 0 belong to the triangle on the right of the edge, or below it (the top-left rule).
 *
 * Depth. 1/z is evaluated in double, rounded to float, and kept within that of the corners. The nearest wins, and among
 * equals the lowest face number: the picture does not depend on the order of drawing, nor on the number of threads.
 *
 * Culling. Every bound used to skip work is evaluated with the same monotone operations as the value that it bounds, or
 * widened: it can cost time, never a sample. */
#include "hot.h"
#include "vectors.h"

/* A cluster's vertices in the sampling plane: homogeneous; in samples (about, with a lens; behind the camera anything); 1/z. */
typedef struct {
    _Alignas(64) double x[CORNERS];
    _Alignas(64) double y[CORNERS];
    _Alignas(64) double z[CORNERS];
    _Alignas(64) double gx[CORNERS];
    _Alignas(64) double gy[CORNERS];
    _Alignas(64) double w[CORNERS];
    _Alignas(64) double front[CORNERS]; /* not positive behind the camera, and where gx, gy are not to be trusted */
} corners;

/* Which sample looks at a plane point, as a patch has it: rounded by less than 1e-6 px where it is sure. */
typedef struct { double x, y; int sure; } place;

static inline place seen_at(const patch *near, double u, double v) {
    const double p = u - near->map.u, q = v - near->map.v;
    const double xp = near->xu * p, xq = near->xv * q, yp = near->yu * p, yq = near->yv * q;
    return (place){near->x + (xp + xq), near->y + (yp + yq), fabs(xp) + fabs(xq) + fabs(yp) + fabs(yq) < 1e6};
}

static void transform(const cc_frame *f, const cluster *c, const patch *near, corners *out) {
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
    if (!near) {
        memcpy(out->front, out->z, (size_t)n * sizeof(double));
        return;
    }
    for (int i = 0; i < n; i++) {
        const place at = seen_at(near, out->gx[i], out->gy[i]);
        out->gx[i] = at.x, out->gy[i] = at.y;
        out->front[i] = at.sure ? out->z[i] : -1;
    }
}

/* Edges and plane of a triangle; 0 where it is seen edge-on or has no area. Side by side: P_1 x P_2, P_2 x P_0, P_0 x P_1
 * and the normal (P_1 - P_0) x (P_2 - P_0). */
static inline int set_up(const cc_frame *f, const corners *v, const uint8_t i[3], triangle *t) {
    const double x0 = v->x[i[0]], x1 = v->x[i[1]], x2 = v->x[i[2]], y0 = v->y[i[0]], y1 = v->y[i[1]], y2 = v->y[i[2]];
    const double z0 = v->z[i[0]], z1 = v->z[i[1]], z2 = v->z[i[2]];
    const d4 px = {x1, x2, x0, x1 - x0}, py = {y1, y2, y0, y1 - y0}, pz = {z1, z2, z0, z1 - z0};
    const d4 qx = {x2, x0, x1, x2 - x0}, qy = {y2, y0, y1, y2 - y0}, qz = {z2, z0, z1, z2 - z0};
    d4 a = py * qz - pz * qy, b = pz * qx - px * qz, c = px * qy - py * qx;
    const double det = a[3] * x0 + b[3] * y0 + c[3] * z0, inverse = 1.0 / det, sign = det < 0 ? -1.0 : 1.0;
    if (!(fabs(det) > 0 && fabs(inverse) <= DBL_MAX && fabs(det) <= DBL_MAX)) return 0;
    const d4 by = {sign, sign, sign, inverse}, far_x = {f->far_x, f->far_x, f->far_x}, far_y = {f->far_y, f->far_y, f->far_y};
    const l4 bare = {INT64_MAX, INT64_MAX, INT64_MAX}, tiny = (l4)((d4){0} + DBL_MIN);
    a *= by, b *= by, c *= by;
    *(d4 *)t->a = a, *(d4 *)t->b = b, *(d4 *)t->c = c;
    *(d4 *)t->size = (d4)((l4)a & bare) * far_x + ((d4)((l4)b & bare) * far_y + (d4)((l4)c & bare));
    /* e = 0 counts on the left and top edges; elsewhere e must be positive */
    *(l4 *)t->least = tiny & ~(l4)((a > 0) | ((a == 0) & (b > 0)));
    return 1;
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

static void bound(const cc_frame *f, const cluster *c, const patch *near, const corners *v, bounds *out) {
    const uint8_t *restrict c0 = f->scene->corner[0] + c->first_face, *restrict c1 = f->scene->corner[1] + c->first_face;
    const uint8_t *restrict c2 = f->scene->corner[2] + c->first_face;
    const double width = f->width, height = f->height;
    const double slack_x = 1e-5 + (near ? near->off_x : 0); /* 1e-5 px: far above rounding */
    const double slack_y = 1e-5 + (near ? near->off_y : 0);
    int n = c->n_faces;
    for (int k = 0; k < n; k++) {
        int p = c0[k], q = c1[k], r = c2[k];
        double near = upper3(v->w[p], v->w[q], v->w[r]), far = lower3(v->w[p], v->w[q], v->w[r]);
        out->gx0[k] = lower3(v->gx[p], v->gx[q], v->gx[r]), out->gx1[k] = upper3(v->gx[p], v->gx[q], v->gx[r]);
        out->gy0[k] = lower3(v->gy[p], v->gy[q], v->gy[r]), out->gy1[k] = upper3(v->gy[p], v->gy[q], v->gy[r]);
        out->front[k] = lower3(v->front[p], v->front[q], v->front[r]);
        out->nearest[k] = (float)lower(near, FLT_MAX), out->farthest[k] = (float)lower(far, FLT_MAX);
    }
    for (int k = 0; k < n; k++) { /* ceil and floor of numbers made at least 0 and -1: both vectorise everywhere */
        double x0 = lower(upper(out->gx0[k] - slack_x, 0), width), y0 = lower(upper(out->gy0[k] - slack_y, 0), height);
        double x1 = lower(upper(out->gx1[k] + slack_x, -1) + 1, width), y1 = lower(upper(out->gy1[k] + slack_y, -1) + 1, height);
        int32_t left = (int32_t)x0, top = (int32_t)y0;
        out->x0[k] = left + (x0 > left), out->y0[k] = top + (y0 > top);
        out->x1[k] = (int32_t)x1 - 1, out->y1[k] = (int32_t)y1 - 1;
    }
}

static inline rect common(rect a, rect b) {
    return (rect){imax(a.x0, b.x0), imin(a.x1, b.x1), imax(a.y0, b.y0), imin(a.y1, b.y1)};
}

/* The part of a rectangle that a triangle may cover as a smaller patch has it. */
static inline rect tightened(const patch *near, const corners *v, const uint8_t i[3], rect r) {
    const d4 x = {v->x[i[0]], v->x[i[1]], v->x[i[2]]}, y = {v->y[i[0]], v->y[i[1]], v->y[i[2]]};
    const d4 w = {v->w[i[0]], v->w[i[1]], v->w[i[2]]}, p = x * w - near->map.u, q = y * w - near->map.v;
    const d4 xp = near->xu * p, xq = near->xv * q, yp = near->yu * p, yq = near->yv * q;
    const d4 at_x = near->x + (xp + xq), at_y = near->y + (yp + yq);
    const l4 bare = {INT64_MAX, INT64_MAX, INT64_MAX};
    const d4 far = ((d4)((l4)xp & bare) + (d4)((l4)xq & bare)) + ((d4)((l4)yp & bare) + (d4)((l4)yq & bare));
    if (!((far[0] < 1e6) & (far[1] < 1e6) & (far[2] < 1e6))) return r;
    const double slack_x = near->off_x + 1e-5, slack_y = near->off_y + 1e-5;
    const double x0 = ceil(upper(lower3(at_x[0], at_x[1], at_x[2]) - slack_x, r.x0));
    const double x1 = floor(lower(upper3(at_x[0], at_x[1], at_x[2]) + slack_x, r.x1));
    const double y0 = ceil(upper(lower3(at_y[0], at_y[1], at_y[2]) - slack_y, r.y0));
    const double y1 = floor(lower(upper3(at_y[0], at_y[1], at_y[2]) + slack_y, r.y1));
    if (!(x0 <= x1 && y0 <= y1)) return (rect){1, 0, 1, 0};
    return (rect){(int32_t)x0, (int32_t)x1, (int32_t)y0, (int32_t)y1};
}

/* Which samples triangle k of a cluster may cover; empty where it is beyond a side of the picture. */
static inline rect reach(const cc_frame *f, const corners *v, bounds *of, const uint8_t i[3], int k) {
    if (!(of->front[k] > 0)) { /* reaches behind the camera: anywhere, in front of its farthest corner */
        if (beyond_a_side(&f->limits, v->x, v->y, v->z, i, 3)) return (rect){1, 0, 1, 0};
        of->nearest[k] = FLT_MAX;
        of->farthest[k] = (float)lower(1 / upper3(v->z[i[0]], v->z[i[1]], v->z[i[2]]), FLT_MAX);
        return (rect){0, f->width - 1, 0, f->height - 1};
    }
    return (rect){of->x0[k], of->x1[k], of->y0[k], of->y1[k]};
}

static void draw_cluster(const band *b, const candidate *which, rect part) {
    const cc_frame *f = b->frame;
    const cc_lens *lens = f->view->lens;
    const cluster *c = &f->scene->clusters[which->index];
    const patch *near = lens ? patch_of(lens, &part) : NULL;
    corners v;
    bounds of;
    transform(f, c, near, &v);
    bound(f, c, near, &v, &of);
    for (int k = 0; k < c->n_faces; k++) {
        size_t at = c->first_face + (size_t)k;
        const uint8_t i[3] = {f->scene->corner[0][at], f->scene->corner[1][at], f->scene->corner[2][at]};
        rect r = common(reach(f, &v, &of, i, k), part);
        if (near && near->off_x + near->off_y > 0.5 && of.front[k] > 0 && r.x0 <= r.x1 && r.y0 <= r.y1)
            r = tightened(patch_of(lens, &r), &v, i, r);
        if (r.x0 > r.x1 || r.y0 > r.y1 || !may_be_seen(b, &r, of.nearest[k])) continue;
        triangle t = {.nearest = of.nearest[k], .farthest = of.farthest[k], .id = f->scene->id[at]};
        if (set_up(f, &v, i, &t)) VARIANT(draw_triangle)(b, &t, &r);
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
            if (isnan(f->view->lens->points[point_of((int32_t)of_lens, k)])) w->inverse_z[t * TILE_AREA + k] = FLT_MAX;
    }
}

int VARIANT(frame_work)(cc_frame *f, cc_worker *worker) {
    for (;;) {
        const int32_t next = atomic_fetch_add(&f->next_band, 1);
        if (next >= f->n_bands) return 0;
        const int32_t first = f->bands[next].first;
        int32_t rows = imin(f->band_rows, f->tiles_y - first);
        size_t tiles = (size_t)rows * (size_t)f->tiles_x;
        if (!worker_reserve(worker, tiles, (size_t)f->view->width * 4)) return -1;
        band b = {f, worker, first * TILE, imin((first + rows) * TILE, f->height) - 1, first};
        clear_band(&b, tiles);
        for (int64_t i = 0; i < f->n_candidates; i++) {
            const candidate *c = &f->candidates[i];
            rect r = {c->where.x0, c->where.x1, imax(c->where.y0, b.y0), imin(c->where.y1, b.y1)};
            if (r.y0 <= r.y1 && may_be_seen(&b, &r, c->nearest)) draw_cluster(&b, c, r);
        }
        VARIANT(write_band)(&b);
    }
}
