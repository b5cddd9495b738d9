/* Rays against triangles: see rays.h.
 *
 * The tree is built by the surface area heuristic in bins (I. Wald, "On fast construction of SAH-based bounding volume
 * hierarchies", IEEE Symposium on Interactive Ray Tracing 2007). A ray meets a triangle as in S. Woop, C. Benthin and
 * I. Wald, "Watertight ray/triangle intersection", Journal of Computer Graphics Techniques 2(1), 2013: for both faces
 * at an edge the same product decides, with opposite signs. */
#include "rays.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    LEAF = 4,     /* triangles of a leaf, at most, where they can be told apart */
    BINS = 16,
    DEEPEST = 40, /* levels made by the heuristic; from there on halves, which at 2^31 triangles are 31 more */
    STACK = 80,
};

typedef struct { double low[3], high[3]; } bounds;

/* A leaf has `count` triangles from `first` on; others have a count of BRANCH and the nodes `first` and `first` + 1. */
typedef struct {
    bounds box;
    int32_t first, count;
} node;

enum { BRANCH = -1 };

struct cc_rays {
    node *nodes;
    double (*corner)[3][3]; /* of the triangles, leaf by leaf */
    int32_t *face;          /* their numbers */
};

static const bounds NOWHERE = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

static void hold(bounds *b, const bounds *other) {
    for (int k = 0; k < 3; k++) {
        if (other->low[k] < b->low[k]) b->low[k] = other->low[k];
        if (other->high[k] > b->high[k]) b->high[k] = other->high[k];
    }
}

/* Half the surface of a box, 0 of none. */
static double area(const bounds *b) {
    const double x = b->high[0] - b->low[0], y = b->high[1] - b->low[1], z = b->high[2] - b->low[2];
    return x >= 0 ? x * y + y * z + z * x : 0;
}

/* Twice the middle of a box along an axis. */
static double middle(const bounds *b, int axis) { return b->low[axis] + b->high[axis]; }

typedef struct {
    cc_rays *rays;
    bounds *box; /* of each triangle, by its number */
    int32_t n_nodes;
} tree;

/* The bin of a triangle among those from `low` on, `per` to a unit of twice the middle. */
static int bin_of(const bounds *b, int axis, double low, double per) {
    const double at = (middle(b, axis) - low) * per;
    return at < BINS - 1 ? (int)at : BINS - 1;
}

/* The bin before which a cut along an axis makes the least of surface times triangles, 0 if none is worth it. */
static int best_cut(const tree *t, const int32_t *face, int32_t n, int axis, double low, double per) {
    bounds of[BINS], all = NOWHERE;
    int32_t count[BINS] = {0}, so_far = 0;
    double left[BINS], best = INFINITY;
    int cut = 0;
    for (int i = 0; i < BINS; i++) of[i] = NOWHERE;
    for (int32_t i = 0; i < n; i++) {
        const int b = bin_of(&t->box[face[i]], axis, low, per);
        hold(&of[b], &t->box[face[i]]), count[b]++;
    }
    for (int i = 0; i < BINS; i++) {
        left[i] = area(&all) * so_far;
        hold(&all, &of[i]), so_far += count[i];
    }
    all = NOWHERE, so_far = 0;
    for (int i = BINS - 1; i > 0; i--) {
        hold(&all, &of[i]), so_far += count[i];
        const double cost = left[i] + area(&all) * so_far;
        if (so_far && so_far < n && cost < best) best = cost, cut = i;
    }
    return cut;
}

/* Moves the triangles in front that lie before a bin, and returns how many there are. */
static int32_t parted(const tree *t, int32_t *face, int32_t n, int axis, double low, double per, int cut) {
    int32_t m = 0;
    for (int32_t i = 0; i < n; i++)
        if (bin_of(&t->box[face[i]], axis, low, per) < cut) {
            const int32_t f = face[i];
            face[i] = face[m], face[m++] = f;
        }
    return m;
}

/* Makes the node at `at` of n triangles, and all below it. */
static void build(tree *t, int32_t at, int32_t *face, int32_t n, int depth) {
    bounds all = NOWHERE, middles = NOWHERE;
    for (int32_t i = 0; i < n; i++) {
        const bounds *b = &t->box[face[i]];
        const double m[3] = {middle(b, 0), middle(b, 1), middle(b, 2)};
        hold(&all, b), hold(&middles, &(bounds){{m[0], m[1], m[2]}, {m[0], m[1], m[2]}});
    }
    t->rays->nodes[at] = (node){all, (int32_t)(face - t->rays->face), n};
    if (n <= LEAF) return;
    int axis = 0;
    for (int k = 1; k < 3; k++)
        if (middles.high[k] - middles.low[k] > middles.high[axis] - middles.low[axis]) axis = k;
    const double low = middles.low[axis], width = middles.high[axis] - low, per = BINS / width;
    int32_t m = n / 2;
    if (depth < DEEPEST && width > 0 && isfinite(per)) {
        const int cut = best_cut(t, face, n, axis, low, per);
        if (cut) m = parted(t, face, n, axis, low, per, cut);
    }
    const int32_t children = t->n_nodes;
    t->n_nodes += 2;
    t->rays->nodes[at].first = children, t->rays->nodes[at].count = BRANCH;
    build(t, children, face, m, depth + 1);
    build(t, children + 1, face + m, n - m, depth + 1);
}

CC_API void cc_rays_free(cc_rays *rays) {
    if (!rays) return;
    free(rays->nodes), free(rays->corner), free(rays->face), free(rays);
}

CC_API cc_rays *cc_rays_new(const double *vertices, const int32_t *faces, int64_t n) {
    const size_t size = (size_t)(n ? n : 1);
    cc_rays *rays = calloc(1, sizeof *rays);
    bounds *box = malloc(size * sizeof *box);
    if (rays) {
        rays->nodes = malloc(2 * size * sizeof *rays->nodes);
        rays->corner = malloc(size * sizeof *rays->corner);
        rays->face = malloc(size * sizeof *rays->face);
    }
    if (!rays || !box || !rays->nodes || !rays->corner || !rays->face) {
        cc_rays_free(rays), free(box);
        return NULL;
    }
    for (int64_t f = 0; f < n; f++) {
        box[f] = NOWHERE, rays->face[f] = (int32_t)f;
        for (int k = 0; k < 3; k++) {
            const double *v = vertices + 3 * (size_t)faces[3 * f + k];
            hold(&box[f], &(bounds){{v[0], v[1], v[2]}, {v[0], v[1], v[2]}});
        }
    }
    build(&(tree){rays, box, 1}, 0, rays->face, (int32_t)n, 0);
    free(box);
    for (int64_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++)
            memcpy(rays->corner[i][k], vertices + 3 * (size_t)faces[3 * (size_t)rays->face[i] + k], 3 * sizeof(double));
    return rays;
}

/* A ray: its origin, one over its direction and whether that is negative, its largest axis z with the two others, and
 * its slopes along it. */
typedef struct {
    double origin[3], inverse[3], slope_x, slope_y;
    int back[3], x, y, z;
} ray;

static ray ray_of(const double *origin, const double *direction) {
    ray r = {.z = 0};
    for (int k = 0; k < 3; k++) {
        r.origin[k] = origin[k], r.inverse[k] = 1 / direction[k], r.back[k] = signbit(direction[k]) != 0;
        if (fabs(direction[k]) > fabs(direction[r.z])) r.z = k;
    }
    r.x = (r.z + 1) % 3, r.y = (r.z + 2) % 3;
    r.slope_x = direction[r.x] * r.inverse[r.z], r.slope_y = direction[r.y] * r.inverse[r.z];
    return r;
}

/* Where a ray enters a box, NaN if it misses it up to `reach`. Widened by the rounding of both (T. Ize, "Robust
 * BVH ray traversal", JCGT 2(2), 2013); the NaN of a ray in the plane of a side is passed over. */
static double entry(const ray *r, const bounds *b, double reach) {
    double near = 0, far = reach;
    for (int k = 0; k < 3; k++) {
        const double in = ((r->back[k] ? b->high : b->low)[k] - r->origin[k]) * r->inverse[k];
        const double out = ((r->back[k] ? b->low : b->high)[k] - r->origin[k]) * r->inverse[k] * (1 + 0x1p-50);
        if (in > near) near = in;
        if (out < far) far = out;
    }
    return near <= far ? near : NAN;
}

/* How far along the ray a triangle is met, infinite if it is not. */
static double met(const ray *r, const double corner[3][3]) {
    double x[3], y[3], z[3], u[3];
    for (int k = 0; k < 3; k++) {
        z[k] = corner[k][r->z] - r->origin[r->z];
        x[k] = corner[k][r->x] - r->origin[r->x] - r->slope_x * z[k];
        y[k] = corner[k][r->y] - r->origin[r->y] - r->slope_y * z[k];
    }
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        u[k] = x[i] * y[j] - x[j] * y[i];
    }
    if ((u[0] < 0 || u[1] < 0 || u[2] < 0) && (u[0] > 0 || u[1] > 0 || u[2] > 0)) return INFINITY;
    const double whole = u[0] + u[1] + u[2];
    const double t = (u[0] * z[0] + u[1] * z[1] + u[2] * z[2]) / whole * r->inverse[r->z];
    return t >= 0 ? t : INFINITY; /* NaN: seen edge-on */
}

static int32_t first_of(const cc_rays *rays, const ray *r, double reach) {
    const double far = fabs(r->origin[0]) + fabs(r->origin[1]) + fabs(r->origin[2]);
    if (!(far < INFINITY && fabs(r->slope_x) <= 1 && fabs(r->slope_y) <= 1)) return -1; /* NaN, or no direction */
    struct { int32_t node; double entry; } stack[STACK];
    int depth = 0;
    int32_t found = -1;
    stack[depth++].node = 0, stack[0].entry = entry(r, &rays->nodes[0].box, reach);
    while (depth) {
        depth--;
        const node *at = &rays->nodes[stack[depth].node];
        if (!(stack[depth].entry <= reach)) continue;
        for (int32_t i = at->first; i < at->first + at->count; i++) {
            const double t = met(r, (const double (*)[3])rays->corner[i]);
            if (t < reach) reach = t, found = rays->face[i];
        }
        if (at->count != BRANCH) continue;
        const int32_t child[2] = {at->first, at->first + 1};
        const double e[2] = {entry(r, &rays->nodes[child[0]].box, reach), entry(r, &rays->nodes[child[1]].box, reach)};
        const int nearer = e[1] < e[0];
        for (int k = 1; k >= 0; k--) {
            const int c = k ^ nearer;
            if (e[c] <= reach) stack[depth].node = child[c], stack[depth++].entry = e[c];
        }
    }
    return found;
}

CC_API void cc_rays_first(const cc_rays *rays, int64_t m, const double *origin, const double *direction,
                          const double *reach, int32_t *face) {
    for (int64_t i = 0; i < m; i++) {
        const ray r = ray_of(origin + 3 * i, direction + 3 * i);
        face[i] = first_of(rays, &r, reach[i]);
    }
}
