/* Which points a rendered view shows: see seen.h. */
#include "seen.h"

#include <math.h>

typedef struct {
    const float *depth, *normal;
    int32_t width, height;
    double fx, fy, steepest;
} sight;

/* The depth at which the face seen at pixel (x, y) meets the ray (u, v, 1) of the point (qx, qy). */
static double depth_towards(const sight *s, int32_t x, int32_t y, double qx, double qy, double u, double v) {
    int64_t at = (int64_t)y * s->width + x;
    double z = s->depth[at];
    const float *n = s->normal + 3 * at;
    double along = n[0] * (qx - x) / s->fx + n[1] * (qy - y) / s->fy;
    double slope = along / (n[0] * u + n[1] * v + n[2]);
    if (!(fabs(slope) <= s->steepest)) slope = slope > 0 ? s->steepest : slope < 0 ? -s->steepest : 0;
    return z * (1 - slope);
}

static int32_t held(int32_t i, int32_t below) { return i < 0 ? 0 : i < below ? i : below - 1; }

/* Whether the point at depth z on the ray (u, v, 1), seen at pixel (x, y), has anything in front on all sides. */
static uint8_t shows(const sight *s, double u, double v, double z, double x, double y, double slack) {
    if (!(x >= -0.5 && x <= s->width - 0.5 && y >= -0.5 && y <= s->height - 0.5 && z > 0)) return 0;
    double least = z * (1 - slack);
    int32_t x0 = (int32_t)floor(x), y0 = (int32_t)floor(y);
    for (int k = 0; k < 4; k++)
        if (depth_towards(s, held(x0 + (k & 1), s->width), held(y0 + (k >> 1), s->height), x, y, u, v) >= least) return 1;
    return 0;
}

void cc_seen(const float *depth, const float *normal, int32_t width, int32_t height, double fx, double fy, double slack,
             double steepest, int64_t n, const double *p, const double *q, uint8_t *out) {
    const sight s = {depth, normal, width, height, fx, fy, steepest};
    for (int64_t i = 0; i < n; i++) {
        double z = p[3 * i + 2];
        out[i] = shows(&s, p[3 * i] / z, p[3 * i + 1] / z, z, q[2 * i], q[2 * i + 1], slack);
    }
}

void cc_seen_lines(const float *depth, const float *normal, int32_t width, int32_t height, const double *K, double slack,
                   double steepest, int64_t n, const double *a, const double *b, const double *wa, const double *wb,
                   const int64_t *samples, uint8_t *out) {
    const sight s = {depth, normal, width, height, K[0], K[4], steepest};
    for (int64_t i = 0; i < n; i++) {
        const double *from = a + 2 * i, *to = b + 2 * i;
        double du = to[0] - from[0], dv = to[1] - from[1];
        for (int64_t k = 0; k < samples[i]; k++) {
            double t = ((double)k + 0.5) / (double)samples[i];
            double u = from[0] + t * du, v = from[1] + t * dv, z = 1 / (wa[i] + t * (wb[i] - wa[i]));
            *out++ = shows(&s, u, v, z, K[0] * u + K[1] * v + K[2], K[4] * v + K[5], slack);
        }
    }
}
