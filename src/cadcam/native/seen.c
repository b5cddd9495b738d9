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

void cc_seen(const float *depth, const float *normal, int32_t width, int32_t height, double fx, double fy, double slack,
             double steepest, int64_t n, const double *p, const double *q, uint8_t *out) {
    const sight s = {depth, normal, width, height, fx, fy, steepest};
    for (int64_t i = 0; i < n; i++) {
        double x = q[2 * i], y = q[2 * i + 1], z = p[3 * i + 2];
        out[i] = 0;
        if (!(x >= -0.5 && x <= width - 0.5 && y >= -0.5 && y <= height - 0.5 && z > 0)) continue;
        double u = p[3 * i] / z, v = p[3 * i + 1] / z, least = z * (1 - slack);
        int32_t x0 = (int32_t)floor(x), y0 = (int32_t)floor(y);
        for (int k = 0; k < 4 && !out[i]; k++)
            out[i] = depth_towards(&s, held(x0 + (k & 1), width), held(y0 + (k >> 1), height), x, y, u, v) >= least;
    }
}
