/* The image of a place on an edge, for sliding, sweeping and climbing. */
#ifndef CADCAM_PLACE_H
#define CADCAM_PLACE_H

#include "field.h"
#include "hot.h"

#define NEAREST 1e-6     /* of the depth: a place this close to the focal plane has no image */

typedef struct { double R[9], t[3]; } rigid;

static inline void product(const double *A, const double *B, double *C) { /* 3 x 3 */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) C[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
}

/* camera_from_part of an eye and a pose (rotation rows, translation). */
static inline rigid seen_by(const cc_eye *eye, const double *pose) {
    rigid c;
    product(eye->rotation, pose, c.R);
    for (int i = 0; i < 3; i++) {
        const double *r = eye->rotation + 3 * i;
        c.t[i] = r[0] * pose[9] + r[1] * pose[10] + r[2] * pose[11] + eye->translation[i];
    }
    return c;
}

/* The image of a place: pixel, direction of the line there (not of unit length), 1/z and (x/z, y/z). */
typedef struct { double x, y, dx, dy, over_z, u, v; } spot;

static inline int image_of(const cc_eye *e, const rigid *c, const cc_place *s, spot *out) {
    const float *p = s->p, *t = s->tangent;
    const double *R = c->R;
    const double X = R[0] * p[0] + R[1] * p[1] + R[2] * p[2] + c->t[0];
    const double Y = R[3] * p[0] + R[4] * p[1] + R[5] * p[2] + c->t[1];
    const double Z = R[6] * p[0] + R[7] * p[1] + R[8] * p[2] + c->t[2];
    if (!(Z > NEAREST * (fabs(X) + fabs(Y)))) return 0;
    const double tx = R[0] * t[0] + R[1] * t[1] + R[2] * t[2], ty = R[3] * t[0] + R[4] * t[1] + R[5] * t[2];
    const double tz = R[6] * t[0] + R[7] * t[1] + R[8] * t[2];
    const double k = 1 / Z, u = X * k, v = Y * k, du = tx - u * tz, dv = ty - v * tz;
    out->x = e->fx * u + e->skew * v + e->cx, out->y = e->fy * v + e->cy;
    out->dx = e->fx * du + e->skew * dv, out->dy = e->fy * dv;
    out->over_z = k, out->u = u, out->v = v;
    return fabs(out->x) < 1e6 && fabs(out->y) < 1e6 && fabs(out->dx) < 1e100 && fabs(out->dy) < 1e100; /* no NaN */
}

/* The sector of a line's normal; the line has direction (dx, dy), its normal twice that angle plus pi when doubled. */
static inline int sector_of(double dx, double dy) {
    const double c = dy * dy - dx * dx, s = -2 * dx * dy, a = fabs(c), b = fabs(s);
    if (b < 0.41421356 * a) return c > 0 ? 0 : 4;
    if (a < 0.41421356 * b) return s > 0 ? 2 : 6;
    return c > 0 ? (s > 0 ? 1 : 7) : (s > 0 ? 3 : 5);
}

/* Rounded, for |x| < 2^20: the value of anything farther outside does not matter. */
static inline int32_t nearest(double x) { return (int32_t)(x + (1048576 + 0.5)) - 1048576; }

#endif
