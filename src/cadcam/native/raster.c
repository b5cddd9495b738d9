/* From clusters to triangles ready to draw, band by band.
 *
 * Homogeneous rasterisation (Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997): with
 * the corners P_i of a triangle in the homogeneous sampling plane, e_0(q) = q . (P_1 x P_2) and its like are linear in
 * the plane point q = (x, y, 1), have one sign inside the triangle's visible part, and 1/z = q . N / (P_0 . N) with N
 * the triangle's normal there. Nothing is divided by z, so triangles that reach behind the camera need no clipping.
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

/* A cluster's vertices in the sampling plane: homogeneous, divided, and 1/z. */
typedef struct {
    _Alignas(64) double x[CORNERS];
    _Alignas(64) double y[CORNERS];
    _Alignas(64) double z[CORNERS];
    _Alignas(64) double u[CORNERS];
    _Alignas(64) double v[CORNERS];
    _Alignas(64) double w[CORNERS];
} corners;

static void transform(const cc_frame *f, const cluster *c, corners *out) {
    const int n = c->n_vertices;
    const double *restrict X = f->scene->vertices + 3 * (size_t)c->first_vertex;
    const double *restrict Y = X + n, *restrict Z = Y + n;
    const double *M = f->view->plane;
    for (int i = 0; i < n; i++) {
        out->x[i] = M[0] * X[i] + M[1] * Y[i] + M[2] * Z[i] + M[3];
        out->y[i] = M[4] * X[i] + M[5] * Y[i] + M[6] * Z[i] + M[7];
        out->z[i] = M[8] * X[i] + M[9] * Y[i] + M[10] * Z[i] + M[11];
    }
    for (int i = 0; i < n; i++) {
        double w = 1.0 / out->z[i];
        out->w[i] = w, out->u[i] = out->x[i] * w, out->v[i] = out->y[i] * w;
    }
}

/* They as pixels, or, with a lens, as samples, about. */
typedef struct {
    _Alignas(64) double x[CORNERS];
    _Alignas(64) double y[CORNERS];
    _Alignas(64) double front[CORNERS]; /* not positive behind the camera, and where x, y are not to be trusted */
} places;

/* Which samples look at them, as a patch has it: rounded by less than 1e-6 px where it is sure. */
static void place(const patch *near, const corners *v, int n, places *out) {
    for (int i = 0; i < n; i++) {
        const double p = v->u[i] - near->map.u, q = v->v[i] - near->map.v;
        const double xp = near->xu * p, xq = near->xv * q, yp = near->yu * p, yq = near->yv * q;
        out->x[i] = near->x + (xp + xq), out->y[i] = near->y + (yp + yq);
        out->front[i] = fabs(xp) + fabs(xq) + fabs(yp) + fabs(yq) < 1e6 ? v->z[i] : -1;
    }
}

INLINE d4 four(const double *of, const uint8_t i[4]) { return (d4){of[i[0]], of[i[1]], of[i[2]], of[i[3]]}; }
INLINE d4 bare(d4 v) { return (d4)((l4)v & INT64_MAX); }

/* Edges and planes of four triangles, with their corners i[0], i[1], i[2]; which of them are neither seen edge-on nor
 * without area, as bits. The edges: P_1 x P_2, P_2 x P_0, P_0 x P_1; the normal: (P_1 - P_0) x (P_2 - P_0). */
INLINE unsigned set_up(const cc_frame *f, const corners *v, const uint8_t i[3][4], quartet *q) {
    d4 x[5], y[5], z[5], *a = q->a, *b = q->b, *c = q->c;
    for (int k = 0; k < 3; k++) x[k] = four(v->x, i[k]), y[k] = four(v->y, i[k]), z[k] = four(v->z, i[k]);
    for (int k = 3; k < 5; k++) x[k] = x[k - 2] - x[0], y[k] = y[k - 2] - y[0], z[k] = z[k - 2] - z[0];
    for (int k = 0; k < 4; k++) {
        const int p = k < 3 ? (k + 1) % 3 : 3, q = k < 3 ? (k + 2) % 3 : 4;
        a[k] = y[p] * z[q] - z[p] * y[q], b[k] = z[p] * x[q] - x[p] * z[q], c[k] = x[p] * y[q] - y[p] * x[q];
    }
    const d4 det = a[3] * x[0] + b[3] * y[0] + c[3] * z[0], one = 1.0 - (d4){0}, inverse = one / det;
    const d4 sign = (d4)((l4)one | ((det < 0) & INT64_MIN)), zero = {0};
    const l4 sound = (bare(det) > zero) & (bare(inverse) <= DBL_MAX + zero) & (bare(det) <= DBL_MAX + zero);
    for (int k = 0; k < 4; k++) {
        const d4 by = k < 3 ? sign : inverse;
        a[k] *= by, b[k] *= by, c[k] *= by;
        q->size[k] = bare(a[k]) * f->far_x + (bare(b[k]) * f->far_y + bare(c[k]));
        /* e = 0 counts on the left and top edges; elsewhere e must be positive */
        q->least[k] = (d4)((l4)(DBL_MIN + zero) & ~((a[k] > zero) | ((a[k] == zero) & (b[k] > zero))));
    }
    unsigned bits = 0;
    for (int m = 0; m < 4; m++) bits |= (unsigned)(sound[m] & 1) << m;
    return bits;
}

/* Those of the pixels' plane in that of a grid's samples: edges that two triangles share stay each other's negative. */
INLINE quartet in_grid(const grid *g, const quartet *of) {
    quartet fine = *of;
    const double s = 1.0 / g->n;
    for (int k = 0; k < 4; k++) {
        fine.a[k] = of->a[k] * s, fine.b[k] = of->b[k] * s;
        fine.c[k] = of->c[k] - (of->a[k] + of->b[k]) * (s * g->shift);
        fine.size[k] = of->size[k] * 2.0; /* samples lie as much as half a pixel beside the centres */
    }
    return fine;
}

/* Whether a triangle of this nearness could be seen in some tile of the rectangle. */
static int may_be_seen(const band *b, const rect *r, float nearest) {
    for (int32_t ty = r->y0 / TILE; ty <= r->y1 / TILE; ty++) {
        const float *row = b->sheet->farthest + (size_t)(ty - b->first_tiles) * (size_t)b->grid->tiles_x;
        for (int32_t tx = r->x0 / TILE; tx <= r->x1 / TILE; tx++)
            if (!(nearest < row[tx])) return 1;
    }
    return 0;
}

/* Triangles of a cluster, side by side: bounds of their places and of 1/z. */
typedef struct {
    _Alignas(64) double x0[CLUSTER], x1[CLUSTER], y0[CLUSTER], y1[CLUSTER];
    _Alignas(64) double front[CLUSTER]; /* smallest z: not positive where a corner lies behind the camera */
    _Alignas(64) float nearest[CLUSTER], farthest[CLUSTER];
} bounds;

/* A cluster being drawn: which of its triangles may be seen in which samples of each grid. */
typedef struct {
    const cluster *cluster;
    const face_block *faces;
    corners corners;
    int n; /* of these triangles: */
    uint8_t which[CLUSTER];
    bounds bounds;
    uint64_t seen[GRIDS]; /* those that may be seen in a grid, as bits, and where */
    rect where[GRIDS][CLUSTER];
} sighting;

static inline void corners_of(const sighting *s, int k, uint8_t i[3]) {
    for (int j = 0; j < 3; j++) i[j] = s->faces->corner[j][s->which[k]];
}

/* List the triangles of a cluster, but for those that show their back, where the view leaves them out: those whose
 * plane the camera is behind by more than the half steps that its numbers are rounded by. */
static void list(const cc_frame *f, sighting *s) {
    const cluster *c = s->cluster;
    const face_block *of = s->faces;
    float at[3], size[3];
    for (int k = 0; k < 3; k++) at[k] = (float)(f->eye[k] - c->low[k]), size[k] = (float)(c->high[k] - c->low[k]);
    const float sides = size[0] + size[1] + size[2];
    const float slack = f->view->fronts ? 0.51f * (fabsf(at[0]) + fabsf(at[1]) + fabsf(at[2]) + sides) : INFINITY;
    uint8_t front[CLUSTER];
    for (int k = 0; k < CLUSTER; k++)
        front[k] = !(of->x[k] * at[0] + of->y[k] * at[1] + of->z[k] * at[2] + of->offset[k] * sides < -slack);
    s->n = 0;
    for (int k = 0; k < c->n_faces; k++) s->which[s->n] = (uint8_t)k, s->n += front[k];
}

static void bound(const double *restrict x, const double *restrict y, const double *restrict front, sighting *s) {
    const double *restrict w = s->corners.w;
    bounds *restrict out = &s->bounds;
    for (int k = 0; k < s->n; k++) {
        uint8_t i[3];
        corners_of(s, k, i);
        const int p = i[0], q = i[1], r = i[2];
        double near = upper3(w[p], w[q], w[r]), far = lower3(w[p], w[q], w[r]);
        out->x0[k] = lower3(x[p], x[q], x[r]), out->x1[k] = upper3(x[p], x[q], x[r]);
        out->y0[k] = lower3(y[p], y[q], y[r]), out->y1[k] = upper3(y[p], y[q], y[r]);
        out->front[k] = lower3(front[p], front[q], front[r]);
        out->nearest[k] = (float)lower(near, FLT_MAX), out->farthest[k] = (float)lower(far, FLT_MAX);
    }
}

/* The samples of a part of a grid that triangles may cover: all of it for those that reach behind the camera. */
typedef struct {
    _Alignas(64) int32_t x0[CLUSTER], x1[CLUSTER], y0[CLUSTER], y1[CLUSTER];
} reaches;

static void reach(const grid *g, const patch *near, const bounds *of, rect part, int n, reaches *out) {
    const double s = near ? 1 : g->scale, t = near ? 0 : g->shift; /* a patch has samples, not pixels */
    const double slack_x = 1e-5 + (near ? near->off_x : 0); /* far above rounding */
    const double slack_y = 1e-5 + (near ? near->off_y : 0);
    const double left = t - slack_x, top = t - slack_y, right = t + slack_x, bottom = t + slack_y;
    const double width = g->width, height = g->height;
    for (int k = 0; k < n; k++) { /* ceil and floor of numbers made at least 0 and -1: both vectorise everywhere */
        double x0 = lower(upper(s * of->x0[k] + left, 0), width), y0 = lower(upper(s * of->y0[k] + top, 0), height);
        double x1 = lower(upper(s * of->x1[k] + right, -1) + 1, width);
        double y1 = lower(upper(s * of->y1[k] + bottom, -1) + 1, height);
        int32_t first = (int32_t)x0, above = (int32_t)y0;
        out->x0[k] = imax(first + (x0 > first), part.x0), out->y0[k] = imax(above + (y0 > above), part.y0);
        out->x1[k] = imin((int32_t)x1 - 1, part.x1), out->y1[k] = imin((int32_t)y1 - 1, part.y1);
        if (!(of->front[k] > 0)) out->x0[k] = part.x0, out->x1[k] = part.x1, out->y0[k] = part.y0, out->y1[k] = part.y1;
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
    if (!(x0 <= x1 && y0 <= y1)) return NOWHERE;
    return (rect){(int32_t)x0, (int32_t)x1, (int32_t)y0, (int32_t)y1};
}

/* Which samples of a rectangle triangle k may cover, in front of the camera or not; empty where it is beyond a side. */
static inline rect covered(const band *b, sighting *s, const reaches *in, const patch *near, int k, rect part) {
    const cc_frame *f = b->frame;
    const corners *v = &s->corners;
    bounds *of = &s->bounds;
    uint8_t i[3];
    if (of->front[k] > 0) {
        const rect r = {in->x0[k], in->x1[k], in->y0[k], in->y1[k]};
        if (!near || near->off_x + near->off_y <= 0.5) return r;
        corners_of(s, k, i);
        return tightened(patch_of(b->grid->lens, &r), v, i, r);
    }
    corners_of(s, k, i); /* reaches behind the camera: anywhere, in front of its farthest corner */
    if (beyond_a_side(&f->limits, v->x, v->y, v->z, i, 3)) return NOWHERE;
    of->nearest[k] = FLT_MAX;
    of->farthest[k] = (float)lower(1 / upper3(v->z[i[0]], v->z[i[1]], v->z[i[2]]), FLT_MAX);
    return part;
}

/* Which triangles reach samples, as bits. */
INLINE uint64_t somewhere(const reaches *in, const sighting *s) {
    uint64_t bits = 0;
    for (int k = 0; k < s->n; k += 8) {
        const i8 x0 = *(const i8 *)(in->x0 + k), x1 = *(const i8 *)(in->x1 + k);
        const i8 y0 = *(const i8 *)(in->y0 + k), y1 = *(const i8 *)(in->y1 + k);
        bits |= (uint64_t)signs((x0 <= x1) & (y0 <= y1)) << k;
    }
    return s->n < CLUSTER ? bits & (((uint64_t)1 << s->n) - 1) : bits;
}

/* Find out where the triangles may be seen in a part of a grid: which of them, as bits. */
static uint64_t sight_in(const band *b, rect part, sighting *s, rect where[]) {
    const patch *near = b->grid->lens ? patch_of(b->grid->lens, &part) : NULL;
    places at;
    reaches in;
    if (near) {
        place(near, &s->corners, s->cluster->n_vertices, &at);
        bound(at.x, at.y, at.front, s);
    }
    reach(b->grid, near, &s->bounds, part, s->n, &in);
    uint64_t seen = 0;
    for (uint64_t left = somewhere(&in, s); left; left &= left - 1) {
        const int k = __builtin_ctzll(left);
        where[k] = covered(b, s, &in, near, k, part);
        if (!empty(where[k]) && may_be_seen(b, &where[k], s->bounds.nearest[k])) seen |= (uint64_t)1 << k;
    }
    return seen;
}

/* Find the triangles of a cluster that may be seen in parts of the grids. */
static void sight(const band bands[], const rect part[], sighting *s) {
    const cc_frame *f = bands[0].frame;
    const corners *v = &s->corners;
    list(f, s);
    for (int g = 0; g < f->n_grids; g++) s->seen[g] = 0;
    if (!s->n) return;
    transform(f, s->cluster, &s->corners);
    if (!bands[0].grid->lens) bound(v->u, v->v, v->z, s);
    for (int g = 0; g < f->n_grids; g++)
        if (!empty(part[g])) s->seen[g] = sight_in(&bands[g], part[g], s, s->where[g]);
}

/* Draw four triangles, by their numbers, in all grids. */
static void draw_four(const band bands[], const sighting *s, const int k[4], int n) {
    const cc_frame *f = bands[0].frame;
    quartet q;
    uint8_t i[3][4];
    for (int m = 0; m < 4; m++) {
        const int face = s->which[k[m]];
        for (int j = 0; j < 3; j++) i[j][m] = s->faces->corner[j][face];
        q.nearest[m] = s->bounds.nearest[k[m]], q.farthest[m] = s->bounds.farthest[k[m]], q.id[m] = s->faces->id[face];
    }
    const unsigned sound = set_up(f, &s->corners, i, &q) & ((1u << n) - 1);
    for (int g = 0; g < f->n_grids; g++) {
        const grid *of = bands[g].grid;
        unsigned which = 0;
        rect r[4];
        for (int m = 0; m < 4; m++) {
            const unsigned seen = s->seen[g] >> k[m] & sound >> m & 1;
            r[m] = seen ? s->where[g][k[m]] : (rect){0}, which |= seen << m;
        }
        if (!which) continue;
        if (of->n > 1 && !of->lens) q = in_grid(of, &q); /* the last grid */
        VARIANT(draw_quartet)(&bands[g], &q, r, which);
    }
}

static void draw_cluster(const band bands[], const cluster *c, const rect part[]) {
    sighting s;
    s.cluster = c, s.faces = bands[0].frame->scene->faces + (c - bands[0].frame->scene->clusters);
    sight(bands, part, &s);
    uint64_t left = s.seen[0];
    for (int g = 1; g < bands[0].frame->n_grids; g++) left |= s.seen[g];
    while (left) {
        int k[4], n = 0;
        for (int m = 0; m < 4; m++) {
            k[m] = left ? __builtin_ctzll(left) : k[0]; /* a repetition, which is not drawn */
            n += left != 0, left &= left - 1;
        }
        draw_four(bands, &s, k, n);
    }
}

/* ---- bands ---------------------------------------------------------------------------------------------------- */

/* Start the part of a grid in the band from row `first` of tiles of centres on; 0 where memory is short. */
static int open_band(const cc_frame *f, cc_worker *w, int g, int32_t first, band *out) {
    const grid *of = &f->grids[g];
    const int32_t top = first * of->n, end = imin((first + f->band_rows) * of->n, of->tiles_y);
    const size_t tiles = (size_t)(end - top) * (size_t)of->tiles_x;
    if (!sheet_reserve(&w->sheets[g], tiles)) return 0;
    *out = (band){f, of, &w->sheets[g], top * TILE, imin(end * TILE, of->height) - 1, top};
    memset(w->sheets[g].farthest, 0, tiles * sizeof(float));
    memset(w->sheets[g].changes, UNTOUCHED, tiles);
    return 1;
}

/* A cluster that may be seen in parts of the grids, or none. */
typedef struct {
    const cluster *cluster;
    rect part[GRIDS];
} due;

static due due_of(const band bands[], const candidate *c) {
    const cc_frame *f = bands[0].frame;
    due d = {NULL};
    for (int g = 0; g < f->n_grids; g++) {
        const band *b = &bands[g];
        d.part[g] = common(c->where[g], (rect){0, b->grid->width - 1, b->y0, b->y1});
        if (!empty(d.part[g]) && !may_be_seen(b, &d.part[g], c->nearest)) d.part[g] = NOWHERE;
        if (!empty(d.part[g])) d.cluster = &f->scene->clusters[c->index];
    }
    return d;
}

INLINE void ask_for(const void *data, size_t bytes) {
    for (size_t k = 0; k < bytes; k += 64) __builtin_prefetch((const char *)data + k);
}

/* Prefetch a cluster: they are scattered in memory, and waiting for them took as long as placing their vertices. */
INLINE void fetch(const cc_scene *s, const cluster *c) {
    ask_for(&s->faces[c - s->clusters], sizeof *s->faces);
    ask_for(s->vertices + 3 * (size_t)c->first_vertex, 3 * c->n_vertices * sizeof *s->vertices);
}

/* Draw all candidates: each is prefetched while the one before it is drawn. */
static void draw_band(const band bands[]) {
    const cc_frame *f = bands[0].frame;
    due next, now = {NULL};
    for (int64_t i = 0; i < f->n_candidates; i++) {
        next = due_of(bands, &f->candidates[i]);
        if (!next.cluster) continue;
        fetch(f->scene, next.cluster);
        if (now.cluster) draw_cluster(bands, now.cluster, now.part);
        now = next;
    }
    if (now.cluster) draw_cluster(bands, now.cluster, now.part);
}

int32_t VARIANT(frame_work)(cc_frame *f, cc_worker *worker) {
    band bands[GRIDS];
    const size_t row = (size_t)f->grids[f->n_grids - 1].tiles_x * TILE;
    if (!row_reserve(worker, row * 8)) return -1; /* sums and means: shade.c */
    for (;;) {
        const int32_t next = atomic_fetch_add(&f->next_band, 1);
        if (next >= f->n_bands) return 0;
        for (int g = 0; g < f->n_grids; g++)
            if (!open_band(f, worker, g, f->bands[next].first, &bands[g])) return -1;
        draw_band(bands);
        for (int g = 0; g < f->n_grids; g++) VARIANT(write_band)(&bands[g], worker->row);
    }
}
