/* Which points and edges a rendered view shows: see seen.h. */
#include "seen.h"
#include "vectors.h"

#include <math.h>
#include <string.h>

static int32_t held(int32_t i, int32_t below) { return i < 0 ? 0 : i < below ? i : below - 1; }

static f4 broad(float v) { return v - (f4){0}; }
static f4 lower(f4 a, f4 b) { return (f4)(((i4)a & (a < b)) | ((i4)b & ~(a < b))); }
static f4 size_of_each(f4 v) { return (f4)((i4)v & INT32_MAX); }

/* Whether the point of inverse depth w on the ray (u, v, 1), seen at pixel (x, y), has nothing in front at one of the
 * four pixel centres around it. The plane of the face seen there meets the ray at its own depth times 1 - slope,
 * slope = along/across: multiplied out, and all four at once. */
static int shows(const cc_depth_view *s, float u, float v, float w, float x, float y) {
    const float right = (float)s->width - 0.5f, bottom = (float)s->height - 0.5f;
    if (!(x >= -0.5f && x <= right && y >= -0.5f && y <= bottom && w > 0)) return 0;
    const int32_t left = (int32_t)(x + 1) - 1, top = (int32_t)(y + 1) - 1; /* floor, of what is above -1 */
    const int32_t x0 = held(left, s->width), x1 = held(left + 1, s->width);
    const int64_t y0 = held(top, s->height), y1 = held(top + 1, s->height);
    const float *const d0 = s->depth + y0 * s->width, *const d1 = s->depth + y1 * s->width;
    const float *const a = s->normal + 3 * (y0 * s->width + x0), *const b = s->normal + 3 * (y0 * s->width + x1);
    const float *const c = s->normal + 3 * (y1 * s->width + x0), *const d = s->normal + 3 * (y1 * s->width + x1);
    const f4 z = {d0[x0], d0[x1], d1[x0], d1[x1]};
    const f4 nx = {a[0], b[0], c[0], d[0]}, ny = {a[1], b[1], c[1], d[1]}, nz = {a[2], b[2], c[2], d[2]};
    const float dx0 = (x - (float)x0) * s->px, dx1 = (x - (float)x1) * s->px;
    const float dy0 = (y - (float)y0) * s->py, dy1 = (y - (float)y1) * s->py;
    const f4 across = nx * broad(u) + ny * broad(v) + nz, size = size_of_each(across) + broad(1e-12f);
    const f4 along = nx * (f4){dx0, dx1, dx0, dx1} + ny * (f4){dy0, dy0, dy1, dy1};
    const f4 rise = lower(size_of_each(along), size * broad(s->steepest)); /* its sign: that of the slope */
    const f4 signed_rise = (f4)((i4)rise | (((i4)along ^ (i4)across) & INT32_MIN));
    const i4 open = z * broad(w) * (size - signed_rise) >= broad(1 - s->slack) * size;
    return (open[0] | open[1] | open[2] | open[3]) != 0;
}

void cc_seen(const cc_depth_view *s, int64_t n, const double *p, const double *q, uint8_t *out) {
    for (int64_t i = 0; i < n; i++) {
        const double w = 1 / p[3 * i + 2], u = p[3 * i] * w, v = p[3 * i + 1] * w;
        out[i] = (uint8_t)shows(s, (float)u, (float)v, (float)w, (float)q[2 * i], (float)q[2 * i + 1]);
    }
}

/* The polyline under way: where it begins, and the edge at whose very end it has arrived, or -1. Its last point but
 * one, and from there: the last one, how far that is at least, and between which directions the line passes what was
 * left out. The sample looked at last: the edge it is of or that followed it, what it showed, how many px back. */
typedef struct {
    cc_lines *to;
    double shortest, bend, length, back;
    double before[2], last[2], reach, left[2], right[2];
    int64_t from, arrived, walked;
    int down, shown;
} pen;

/* The end of a line, or of none. */
static void lift(pen *n) {
    cc_lines *to = n->to;
    if (n->down && n->length >= n->shortest) {
        if (to->lines < to->room) to->start[to->lines] = (int32_t)n->from;
        to->lines++;
    } else if (n->down)
        to->points = n->from;
    n->down = 0;
}

static double cross(const double a[2], const double b[2]) { return a[0] * b[1] - a[1] * b[0]; }

/* Whether the last point is not needed on the way to q: the straight line from the one before passes all that were left
 * out since within `bend` px (Williams, "Fast polyline approximation", Comput. J. 21, 1978). Be ready for the next. */
static int needless(pen *n, const double q[2]) {
    double to[2] = {q[0] - n->before[0], q[1] - n->before[1]}, reach = sqrt(to[0] * to[0] + to[1] * to[1]);
    const int passes = n->reach > 0 && reach >= n->reach && cross(n->right, to) >= 0 && cross(to, n->left) >= 0;
    if (!passes) {
        to[0] = q[0] - n->last[0], to[1] = q[1] - n->last[1], reach = sqrt(to[0] * to[0] + to[1] * to[1]);
        memcpy(n->before, n->last, sizeof n->last);
    }
    const double aside = reach > 0 ? n->bend / reach : 0;
    const double left[2] = {to[0] - aside * to[1], to[1] + aside * to[0]};
    const double right[2] = {to[0] + aside * to[1], to[1] - aside * to[0]};
    if (!passes || cross(left, n->left) > 0) memcpy(n->left, left, sizeof left);
    if (!passes || cross(n->right, right) > 0) memcpy(n->right, right, sizeof right);
    n->reach = reach;
    return passes;
}

static void point(pen *n, const double q[2], const double p[3], int64_t edge) {
    cc_lines *to = n->to;
    const int64_t at = to->points++;
    memcpy(n->last, q, sizeof n->last);
    if (at >= to->room) return;
    to->q[2 * at] = q[0], to->q[2 * at + 1] = q[1];
    for (int i = 0; i < 3; i++) to->p[3 * at + i] = p[i];
    to->edge[at] = (int32_t)edge;
}

/* An end of an edge for the camera: where in its axes, in the plane (x, y)/z, at which pixel, whether it sees it. */
typedef struct {
    double p[3], u[2], w, q[2];
    int in_view;
} corner;

/* An edge in view: what is left of it is from t0 to t1. */
typedef struct {
    const corner *a, *b;
    corner cut[2]; /* what they are where it is cut */
    const double *ends; /* (2, 3), in space */
    double t0, t1;
    int64_t number;
    int goes_on; /* where the edge before it ended */
} line;

static void look_at(const cc_depth_view *s, const cc_eye_point *eye, corner *c) {
    const double *K = eye->K, *p = c->p;
    c->w = 1 / p[2];
    c->u[0] = p[0] * c->w, c->u[1] = p[1] * c->w;
    c->q[0] = K[0] * c->u[0] + K[1] * c->u[1] + K[2], c->q[1] = K[4] * c->u[1] + K[5];
    const double x = c->q[0] + 0.5, y = c->q[1] + 0.5;
    c->in_view = p[2] >= eye->near && x >= 0 && x <= s->width && y >= 0 && y <= s->height;
}

static void carry(const cc_depth_view *s, const cc_eye_point *eye, const double world[3], corner *c) {
    for (int i = 0; i < 3; i++) {
        const double *row = eye->pose + 4 * i;
        c->p[i] = row[0] * world[0] + row[1] * world[1] + row[2] * world[2] + row[3];
    }
    look_at(s, eye, c);
}

/* How far a point lies inside each border of what the camera sees, in numbers linear in the point: pixels times z. */
static void borders(const cc_depth_view *s, const cc_eye_point *eye, const double p[3], double inside[5]) {
    const double *K = eye->K;
    const double x = K[0] * p[0] + K[1] * p[1] + (K[2] + 0.5) * p[2], y = K[4] * p[1] + (K[5] + 0.5) * p[2];
    inside[0] = x, inside[1] = s->width * p[2] - x;
    inside[2] = y, inside[3] = s->height * p[2] - y;
    inside[4] = p[2] - eye->near;
}

/* Find what of the line is in view; 0 if nothing is. */
static int clip(const cc_depth_view *s, const cc_eye_point *eye, line *l) {
    double one[5], other[5];
    l->t0 = 0, l->t1 = 1;
    if (l->a->in_view && l->b->in_view) return 1;
    borders(s, eye, l->a->p, one), borders(s, eye, l->b->p, other);
    for (int k = 0; k < 5; k++) {
        const double a = one[k], b = other[k];
        if (a >= 0 && b >= 0) continue;
        if (!(a >= 0) && !(b >= 0)) return 0;
        if (b >= 0)
            l->t0 = fmax(l->t0, a / (a - b));
        else
            l->t1 = fmin(l->t1, a / (a - b));
    }
    return l->t0 < l->t1;
}

/* Cut a clipped line to what is left of it. */
static void cut(const cc_depth_view *s, const cc_eye_point *eye, line *l) {
    const double *a = l->a->p, *b = l->b->p;
    if (l->t0 == 0 && l->t1 == 1) return;
    for (int i = 0; i < 3; i++)
        l->cut[0].p[i] = a[i] + l->t0 * (b[i] - a[i]), l->cut[1].p[i] = a[i] + l->t1 * (b[i] - a[i]);
    look_at(s, eye, l->cut), look_at(s, eye, l->cut + 1);
    l->a = l->cut, l->b = l->cut + 1;
}

/* The point at share s of the line's image, where 1/z is linear. */
static void mark(pen *n, const line *l, double s, int first) {
    const double along = s * l->b->w / (s * l->b->w + (1 - s) * l->a->w), t = l->t0 + (l->t1 - l->t0) * along;
    double q[2], p[3];
    for (int i = 0; i < 2; i++) q[i] = l->a->q[i] + s * (l->b->q[i] - l->a->q[i]);
    if (first)
        n->reach = 0;
    else if (needless(n, q))
        n->to->points--;
    for (int i = 0; i < 3; i++) p[i] = l->ends[i] + t * (l->ends[3 + i] - l->ends[i]);
    point(n, q, p, l->number);
}

/* Draw the shares [s0, s1] of a line of so many pixels: on from the last point, or as another polyline. */
static void draw(pen *n, const line *l, double s0, double s1, double length) {
    if (l->goes_on && n->arrived == l->number - 1 && s0 == 0 && l->t0 == 0) {
        if (n->to->points <= n->to->room) n->to->edge[n->to->points - 1] = (int32_t)l->number;
    } else {
        lift(n);
        n->from = n->to->points, n->length = 0, n->down = 1;
        mark(n, l, s0, 1);
    }
    mark(n, l, s1, 0);
    n->length += (s1 - s0) * length;
    n->arrived = s1 == 1 && l->t1 == 1 ? l->number : -1;
}

/* Draw the runs of seen samples, each in the middle of its share of the line. */
static void walk_on(pen *n, const cc_depth_view *s, const line *l, double length, int32_t samples) {
    const corner *a = l->a, *b = l->b;
    const double dx = b->q[0] - a->q[0], dy = b->q[1] - a->q[1], dw = b->w - a->w, share = 1.0 / samples;
    const double du = b->u[0] - a->u[0], dv = b->u[1] - a->u[1];
    int32_t seen = 0; /* how many in a row, up to the last one */
    for (int32_t k = 0; k < samples; k++) {
        const double t = (k + 0.5) * share;
        n->shown = shows(s, (float)(a->u[0] + t * du), (float)(a->u[1] + t * dv), (float)(a->w + t * dw),
                         (float)(a->q[0] + t * dx), (float)(a->q[1] + t * dy));
        if (!n->shown && seen) draw(n, l, (double)(k - seen) / samples, (double)k / samples, length);
        seen = n->shown ? seen + 1 : 0;
    }
    if (seen) draw(n, l, (double)(samples - seen) / samples, 1, length);
    n->back = 0.5 * length * share;
}

/* Draw the visible parts of a line. A piece shorter than a step since the last sample counts as that sample did. */
static void walk(pen *n, const cc_depth_view *s, const line *l, double step) {
    const double dx = l->b->q[0] - l->a->q[0], dy = l->b->q[1] - l->a->q[1], length = sqrt(dx * dx + dy * dy);
    const int near = l->goes_on && n->walked == l->number - 1 && n->back + length < step;
    if (!(length <= 2.0 * ((double)s->width + s->height))) return; /* no number */
    n->walked = l->number;
    if (!near)
        walk_on(n, s, l, length, length > step ? (int32_t)(length / step + 0.5) : 1);
    else if (n->shown)
        draw(n, l, 0, 1, length);
    if (near) n->back += length;
}

/* Whether an edge is wanted, by its rule, where the camera is in front of its first face (2) and of its other (1). */
static const uint8_t wanted[3][4] = {
    [CC_ALWAYS] = {1, 1, 1, 1}, [CC_FACING] = {0, 1, 1, 1}, [CC_TURNING] = {0, 1, 1, 0}};

/* Find the edges wanted among those from `from` on, before `to`; return how many. Most of them are not, by no pattern:
 * no branch is taken on it. */
static int32_t find_wanted(const cc_edges *edges, const uint8_t *front, int64_t from, int64_t to, int64_t *found) {
    int32_t n = 0;
    for (int64_t i = from; i < to; i++) {
        found[n] = i;
        n += wanted[edges->rule[i]][2 * front[edges->sides[2 * i]] + front[edges->sides[2 * i + 1]]];
    }
    return n;
}

void cc_seen_edges(const cc_depth_view *view, const cc_eye_point *eye, const cc_edges *edges, const uint8_t *front,
                   double step, double shortest, double bend, cc_lines *lines) {
    enum { BLOCK = 1024 };
    pen n = {.to = lines, .shortest = shortest, .bend = bend, .arrived = -1, .walked = -1};
    const double *last = NULL; /* where `end` is in space: mostly the next edge begins there */
    corner ends[2]; /* of the edge: by turns one of them is where the edge before ended */
    int64_t found[BLOCK], k = 0;
    lines->points = lines->lines = 0;
    for (int64_t from = 0; from < edges->n; from += BLOCK) {
        const int32_t count = find_wanted(edges, front, from, from + BLOCK < edges->n ? from + BLOCK : edges->n, found);
        for (int32_t j = 0; j < count; j++, k++) {
            const int64_t i = found[j];
            if (j + 8 < count) __builtin_prefetch(edges->ends + 6 * found[j + 8]);
            corner *const a = ends + (k & 1), *const b = ends + (~k & 1);
            line l;
            l.a = a, l.b = b, l.ends = edges->ends + 6 * i, l.number = i;
            l.goes_on = i && edges->chain[i] == edges->chain[i - 1];
            if (!last || last[0] != l.ends[0] || last[1] != l.ends[1] || last[2] != l.ends[2])
                carry(view, eye, l.ends, a);
            carry(view, eye, l.ends + 3, b);
            last = l.ends + 3;
            if (!clip(view, eye, &l)) continue;
            cut(view, eye, &l);
            walk(&n, view, &l, step);
        }
    }
    lift(&n);
}
