/* Occlusion of a point by a scene, decided exactly in space, without a rendered picture. */
#include <math.h>

#include "internal.h"

/* The segment from a point p to the eye, of direction d, and its bounding box. */
typedef struct { double p[3], d[3], low[3], high[3]; } sight_line;

static void cross(const double a[3], const double b[3], double out[3]) {
    for (int k = 0; k < 3; k++) out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static sight_line line_to(const double eye[3], const double p[3]) {
    sight_line l;
    for (int k = 0; k < 3; k++) {
        l.p[k] = p[k], l.d[k] = eye[k] - p[k];
        l.low[k] = fmin(p[k], eye[k]), l.high[k] = fmax(p[k], eye[k]);
    }
    return l;
}

static int boxes_apart(const sight_line *l, const cluster *c) {
    return l->high[0] < c->low[0] || l->low[0] > c->high[0] || l->high[1] < c->low[1] || l->low[1] > c->high[1] ||
           l->high[2] < c->low[2] || l->low[2] > c->high[2];
}

/* Whether a line may meet a cluster's box: no separating axis, nor one across it and the line (Gottschalk, Lin
 * and Manocha, "OBBTree", SIGGRAPH 1996). */
static int may_meet(const sight_line *l, const cluster *c) {
    double off[3], size[3];
    if (boxes_apart(l, c)) return 0;
    for (int k = 0; k < 3; k++) {
        off[k] = 0.5 * (c->low[k] + c->high[k]) - l->p[k];
        size[k] = 0.5 * (c->high[k] - c->low[k]);
    }
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        const double reach = size[i] * fabs(l->d[j]) + size[j] * fabs(l->d[i]);
        const double one = l->d[i] * off[j], other = l->d[j] * off[i];
        if (fabs(one - other) > reach + 0x1p-40 * (fabs(one) + fabs(other))) return 0;
    }
    return 1;
}

/* Whether a triangle meets the open line while p lies more than `tolerance` off its plane. Its sides count as it: two
 * that share one leave no gap, as the volume that a side spans with the line is exactly the negative of the other's. */
static int hides(const sight_line *l, const double corner[3][3], double tolerance) {
    double to[3][3], side[2][3], normal[3], volume[3], turned[3];
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 3; i++) to[k][i] = corner[k][i] - l->p[i];
    for (int k = 0; k < 3; k++) cross(to[k], to[(k + 1) % 3], turned), volume[k] = dot(l->d, turned);
    const int out = volume[0] <= 0 && volume[1] <= 0 && volume[2] <= 0;
    const int in = volume[0] >= 0 && volume[1] >= 0 && volume[2] >= 0;
    if (!out && !in) return 0;
    for (int i = 0; i < 3; i++) side[0][i] = to[1][i] - to[0][i], side[1][i] = to[2][i] - to[0][i];
    cross(side[0], side[1], normal);
    const double height = dot(normal, to[0]), run = dot(normal, l->d); /* of the plane above p; rise of the line */
    return fabs(height) > tolerance * sqrt(dot(normal, normal)) && height / run > 0 && height / run < 1;
}

static int cluster_hides(const cc_scene *s, int64_t i, const sight_line *l, double tolerance) {
    const cluster *c = &s->clusters[i];
    const face_block *of = &s->faces[i];
    const double *v = s->vertices + 3 * (size_t)c->first_vertex;
    for (int f = 0; f < c->n_faces; f++) {
        double corner[3][3];
        for (int k = 0; k < 3; k++)
            for (int axis = 0; axis < 3; axis++) corner[k][axis] = v[axis * c->n_vertices + of->corner[k][f]];
        if (hides(l, corner, tolerance)) return 1;
    }
    return 0;
}

CC_API void cc_scene_hides(const cc_scene *scene, const double eye[3], double tolerance, int64_t n, const double *p,
                           uint8_t *out) {
    for (int64_t j = 0; j < n; j++) {
        const sight_line l = line_to(eye, p + 3 * j);
        out[j] = 0;
        for (int64_t i = 0; i < scene->n_clusters && !out[j]; i++)
            out[j] = may_meet(&l, &scene->clusters[i]) && cluster_hides(scene, i, &l, tolerance);
    }
}
