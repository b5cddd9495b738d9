/* Which clusters a picture may show, nearest first. */
#include "hot.h"

enum { GROUP = 8 }; /* clusters placed together: SHARE is a multiple */

#define ROUGH 400.0 /* px: if the patch of a group has a larger error, its clusters are looked up separately */

/* A float that is at least (at most) v, for bounds of 1/z. */
static inline float float_above(double v) { return v < FLT_MAX / 2 ? (float)(v * (1 + 1e-6)) : FLT_MAX; }

/* The samples of a rectangle that may look at a box of the plane, as the patch of the rectangle has it. */
static rect narrowed(const cc_lens *lens, rect r, const box *b) {
    const patch *near = patch_of(lens, &r);
    const double p = 0.5 * (b->x0 + b->x1) - near->map.u, p1 = 0.5 * (b->x1 - b->x0);
    const double q = 0.5 * (b->y0 + b->y1) - near->map.v, q1 = 0.5 * (b->y1 - b->y0);
    const double x = near->x + (near->xu * p + near->xv * q), y = near->y + (near->yu * p + near->yv * q);
    const double wide = fabs(near->xu) * p1 + fabs(near->xv) * q1 + near->off_x + 1e-3; /* 1e-3 px: above rounding */
    const double high = fabs(near->yu) * p1 + fabs(near->yv) * q1 + near->off_y + 1e-3;
    if (!(fabs(x) + fabs(y) + wide + high < 1e6)) return r;
    r.x0 = imax(r.x0, (int32_t)(x - wide)), r.x1 = imin(r.x1, (int32_t)(x + wide + 1) - 1);
    r.y0 = imax(r.y0, (int32_t)(y - high)), r.y1 = imin(r.y1, (int32_t)(y + high + 1) - 1);
    return r;
}

/* Whether a cluster may be seen: nowhere, anywhere (where it reaches behind the camera), or in a box of the plane. */
typedef enum { NOT_SEEN, SEEN_SOMEWHERE, SEEN_IN_BOX } sight;

static sight project_cluster(const cc_frame *f, const cluster *c, candidate *out, double *nearest_z, box *seen) {
    static const uint8_t all[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    const double *M = f->view->plane;
    const double X0 = c->low[0], X1 = c->high[0], Y0 = c->low[1], Y1 = c->high[1], Z0 = c->low[2], Z1 = c->high[2];
    const double X[8] = {X0, X1, X0, X1, X0, X1, X0, X1}, Y[8] = {Y0, Y0, Y1, Y1, Y0, Y0, Y1, Y1};
    const double Z[8] = {Z0, Z0, Z0, Z0, Z1, Z1, Z1, Z1};
    double x[8], y[8], z[8], gx[8], gy[8];
    box b = {INFINITY, -INFINITY, INFINITY, -INFINITY};
    double z0 = INFINITY, z1 = -INFINITY;
    for (int k = 0; k < 8; k++) {
        x[k] = M[0] * X[k] + M[1] * Y[k] + M[2] * Z[k] + M[3];
        y[k] = M[4] * X[k] + M[5] * Y[k] + M[6] * Z[k] + M[7];
        z[k] = M[8] * X[k] + M[9] * Y[k] + M[10] * Z[k] + M[11];
        gx[k] = x[k] / z[k], gy[k] = y[k] / z[k];
    }
    for (int k = 0; k < 8; k++) z0 = lower(z0, z[k]), z1 = upper(z1, z[k]);
    double size = upper(fabs(z0), fabs(z1));
    *nearest_z = z0 = z0 - 1e-9 * size; /* the box' corners are rounded: stay on the safe side */
    if (!(z0 > 1e-6 * size)) { /* reaches (nearly) behind the camera */
        if (z1 + 1e-9 * size <= 0 || beyond_a_side(&f->limits, x, y, z, all, 8)) return NOT_SEEN;
        out->nearest = INFINITY;
        return SEEN_SOMEWHERE;
    }
    for (int k = 0; k < 8; k++) {
        b.x0 = lower(b.x0, gx[k]), b.x1 = upper(b.x1, gx[k]);
        b.y0 = lower(b.y0, gy[k]), b.y1 = upper(b.y1, gy[k]);
    }
    if (b.x1 < f->limits.x0 || b.x0 > f->limits.x1 || b.y1 < f->limits.y0 || b.y0 > f->limits.y1) return NOT_SEEN;
    out->nearest = float_above(1 / z0);
    *seen = b;
    return SEEN_IN_BOX;
}

/* Bounds of the samples that may see a box of the plane, by the cells of the lens or by pixels. */
static rect looking_at(const grid *g, const box *b) {
    const cc_lens *lens = g->lens;
    return samples_of(g, (box){grid_x(lens, b->x0) - 1e-3, grid_x(lens, b->x1) + 1e-3, grid_y(lens, b->y0) - 1e-3,
                               grid_y(lens, b->y1) + 1e-3});
}

/* The samples of a grid that may see each of some clusters. These are neighbours: with a lens, its cells are asked once
 * for all of them, its patches then for each. */
static void place_group(const grid *g, int n, const sight how[], const box b[], rect out[]) {
    box all = {INFINITY, -INFINITY, INFINITY, -INFINITY};
    for (int k = 0; k < n; k++) {
        if (how[k] != SEEN_IN_BOX) continue;
        all.x0 = lower(all.x0, b[k].x0), all.x1 = upper(all.x1, b[k].x1);
        all.y0 = lower(all.y0, b[k].y0), all.y1 = upper(all.y1, b[k].y1);
    }
    const cc_lens *lens = g->lens;
    const rect none = NOWHERE, any = lens && all.x0 <= all.x1 ? looking_at(g, &all) : none;
    const patch *near = empty(any) ? NULL : patch_of(lens, &any);
    const int together = near && near->off_x + near->off_y < ROUGH;
    for (int k = 0; k < n; k++) {
        if (how[k] == SEEN_SOMEWHERE) out[k] = whole_grid(g);
        else if (lens && !near) out[k] = none;
        else {
            out[k] = together ? narrowed(lens, any, &b[k]) : looking_at(g, &b[k]);
            if (lens && !empty(out[k])) out[k] = narrowed(lens, out[k], &b[k]);
        }
    }
}

/* Put the clusters from `first` on, GROUP of them, that may be seen at `out`, with their depths; how many. */
static int locate_group(const cc_frame *f, int64_t first, candidate *out, double *depth) {
    const cc_scene *s = f->scene;
    const int64_t end = first + GROUP < s->n_clusters ? first + GROUP : s->n_clusters;
    candidate found[GROUP];
    box b[GROUP];
    double z[GROUP];
    sight how[GROUP];
    rect where[GRIDS][GROUP];
    int n = 0, kept = 0;
    for (int64_t i = first; i < end; i++) {
        found[n].index = (uint32_t)i;
        how[n] = project_cluster(f, &s->clusters[i], &found[n], &z[n], &b[n]);
        n += how[n] != NOT_SEEN;
    }
    for (int g = 0; g < f->n_grids; g++) place_group(&f->grids[g], n, how, b, where[g]);
    for (int k = 0; k < n; k++) {
        int seen = 0;
        for (int g = 0; g < f->n_grids; g++) found[k].where[g] = where[g][k], seen |= !empty(where[g][k]);
        if (seen) depth[kept] = z[k], out[kept++] = found[k];
    }
    return kept;
}

/* The shares' candidates, concatenated. */
static void gather(cc_frame *f) {
    for (int32_t k = 0; k < f->n_shares; k++) {
        const size_t from = (size_t)k * SHARE, to = (size_t)f->n_candidates, n = (size_t)f->found[k];
        memmove(f->located + to, f->located + from, n * sizeof *f->located);
        memmove(f->depth + to, f->depth + from, n * sizeof *f->depth);
        f->n_candidates += f->found[k];
    }
}

/* Nearest first, roughly: a counting sort over 4096 steps of depth, enough for hidden clusters to come last. */
static void sort_by_depth(cc_frame *f) {
    enum { STEPS = 4096 };
    uint32_t at[STEPS + 1] = {0};
    const size_t n = (size_t)f->n_candidates;
    double low = INFINITY, high = -INFINITY, *depth = f->depth;
    for (size_t i = 0; i < n; i++) {
        depth[i] = upper(depth[i], 0);
        low = lower(low, depth[i]), high = upper(high, depth[i]);
    }
    double scale = high > low ? (STEPS - 1) / (high - low) : 0;
    if (!(scale < INFINITY)) scale = 0;
    for (size_t i = 0; i < n; i++) at[(uint32_t)((depth[i] - low) * scale) + 1]++;
    for (int k = 0; k < STEPS; k++) at[k + 1] += at[k];
    for (size_t i = 0; i < n; i++) f->candidates[at[(uint32_t)((depth[i] - low) * scale)]++] = f->located[i];
}

/* Shares until none is left; whether this was the last to be done. Candidates stand in the order of their clusters,
 * whoever found them. */
int VARIANT(frame_look)(cc_frame *f) {
    for (;;) {
        const int32_t k = atomic_fetch_add(&f->next_share, 1);
        if (k >= f->n_shares) return 0;
        const int64_t first = (int64_t)k * SHARE, end = first + SHARE < f->n_clusters ? first + SHARE : f->n_clusters;
        int32_t n = 0;
        for (int64_t i = first; i < end; i += GROUP)
            n += locate_group(f, i, f->located + first + n, f->depth + first + n);
        f->found[k] = n;
        if (atomic_fetch_sub(&f->shares_left, 1) > 1) continue;
        gather(f), sort_by_depth(f);
        return 1;
    }
}
