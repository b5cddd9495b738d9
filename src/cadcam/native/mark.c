/* The picture of a mark and its slopes: see mark.h. */
#include "mark.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846
#define SLOPES 10       /* by the nine numbers of H, row by row, and by s */
#define REACH 7.0       /* sigmas from a border, beyond which there is no blur */
#define ROUND 1e-9      /* rad, of a span that is a half turn */

typedef struct { double v, d[SLOPES]; } share; /* of ink, with its slopes */

/* A border as a straight line at a pixel: t sigmas inside it, unit normal n in the picture; their slopes, turn by H:
 * that of the normal's direction. */
typedef struct { double t, n[2], dt[SLOPES], turn[9]; } line;

typedef struct {
    const double *H;
    double m[2], L[2][2], N[3]; /* dm/dq; H (m, 1) */
    double s;
} pixel;

typedef struct { int count; double z[9], weight[9]; } rule; /* Gauss and Hermite's, for a normal distribution */

static const rule RULES[4] = {
    {2, {-1, 1}, {0.5, 0.5}},
    {3, {-1.7320508075688772, 0, 1.7320508075688772}, {1. / 6, 2. / 3, 1. / 6}},
    {5,
     {-2.8569700138728056, -1.355626179974266, 0, 1.355626179974266, 2.8569700138728056},
     {0.011257411327720693, 0.22207592200561266, 0.5333333333333334, 0.22207592200561266, 0.011257411327720693}},
    {9,
     {-4.512745863399783, -3.20542900285647, -2.07684797867783, -1.0232556637891324, 0, 1.0232556637891324,
      2.07684797867783, 3.20542900285647, 4.512745863399783},
     {2.2345844007746723e-05, 0.0027891413212317453, 0.04991640676521787, 0.2440975028949394, 0.4063492063492063,
      0.2440975028949394, 0.04991640676521787, 0.0027891413212317453, 2.2345844007746723e-05}},
};
static const double BENT[3] = {0.08, 0.3, 0.8}; /* curvature by s up to which a rule serves */

/* Gauss and Legendre's rule of eight nodes on [-1, 1]: those above 0. */
static const double AT[4] = {0.1834346424956498, 0.525532409916329, 0.7966664774136267, 0.9602898564975363};
static const double BY[4] = {0.362683783378362, 0.3137066458778873, 0.2223810344533745, 0.10122853629037626};
#define PANEL 8.0 /* sigmas of a motion that eight nodes serve */

static double node(int i) { return i < 4 ? AT[i] : -AT[i - 4]; }

static double normal(double x) { return 0.5 * erfc(-x * 0.70710678118654752440); }
static double density(double x) { return 0.39894228040143267794 * exp(-0.5 * x * x); }

/* The largest and smallest singular values of [[a, b], [c, d]]. */
static void stretches(double a, double b, double c, double d, double *large, double *small) {
    double p = hypot(a + d, b - c), q = hypot(a - d, b + c);
    *large = 0.5 * (p + q), *small = 0.5 * fabs(p - q);
}

/* n and its tangent as steps of m, and of N. */
static void along(const pixel *p, const double *n, double *step, double *N) {
    for (int i = 0; i < 2; i++) step[i] = p->L[i][0] * n[0] + p->L[i][1] * n[1];
    for (int i = 0; i < 3; i++) N[i] = p->H[3 * i] * step[0] + p->H[3 * i + 1] * step[1];
}

/* The gradient in the picture of e = w . N, for fixed w: its length; n is its direction. */
static double gradient(const pixel *p, const double *w, double *n) {
    double m[2];
    for (int j = 0; j < 2; j++) m[j] = w[0] * p->H[j] + w[1] * p->H[3 + j] + w[2] * p->H[6 + j];
    double x = p->L[0][0] * m[0] + p->L[1][0] * m[1], y = p->L[0][1] * m[0] + p->L[1][1] * m[1];
    double g = hypot(x, y);
    n[0] = g > 0 ? x / g : 1, n[1] = g > 0 ? y / g : 0;
    return g;
}

/* What w = (-a, r) is for the border of radius r, a the unit vector from the centre: e = w . N is 0 on it. */
static void outward(const pixel *p, double r, double *w) {
    double rho = hypot(p->N[0], p->N[1]);
    w[0] = rho > 0 ? -p->N[0] / rho : -1, w[1] = rho > 0 ? -p->N[1] / rho : 0, w[2] = r;
}

/* The share of a Gaussian about the pixel that lies in the disc of radius r. */
static share disc(const pixel *p, double r, const rule *nodes, double steepest, int slopes) {
    share out = {0};
    double w[3], n[2], step[2], across[2], N1[3], NT[3], r2 = r * r, s = p->s;
    outward(p, r, w);
    double e = w[0] * p->N[0] + w[1] * p->N[1] + w[2] * p->N[2];
    if (fabs(e) > REACH * s * steepest) {
        out.v = e > 0;
        return out;
    }
    gradient(p, w, n);
    const double tangent[2] = {-n[1], n[0]};
    along(p, n, step, N1), along(p, tangent, across, NT);
    double bend = r2 * N1[2] * N1[2] - N1[0] * N1[0] - N1[1] * N1[1];
    if (!(bend < 0)) { /* no ellipse */
        out.v = e > 0;
        return out;
    }
    for (int k = 0; k < nodes->count; k++) { /* the border crosses each line where bend u^2 + 2 b u + c = 0 */
        double z = nodes->z[k] * s, N0[3];
        for (int i = 0; i < 3; i++) N0[i] = p->N[i] + z * NT[i];
        double b = r2 * N0[2] * N1[2] - N0[0] * N1[0] - N0[1] * N1[1];
        double c = r2 * N0[2] * N0[2] - N0[0] * N0[0] - N0[1] * N0[1], root = b * b - bend * c;
        if (!(root > 0)) continue;
        root = sqrt(root);
        double q = b > 0 ? -b - root : root - b; /* without cancellation */
        double u[2] = {b > 0 ? c / q : q / bend, b > 0 ? q / bend : c / q};
        if (q == 0) u[0] = u[1] = 0;
        for (int side = 0; side < 2; side++) { /* where the line enters the disc, and where it leaves */
            double sign = side ? 1 : -1, t = u[side] / s;
            out.v += sign * nodes->weight[k] * (t > REACH ? 1 : t < -REACH ? 0 : normal(t));
            if (!slopes || fabs(t) > REACH) continue;
            double weight = nodes->weight[k] * density(t) / s, steep = weight / fmax(root, 1e-12);
            double m[3] = {p->m[0] + z * across[0] + u[side] * step[0], p->m[1] + z * across[1] + u[side] * step[1], 1};
            double at[3];
            for (int i = 0; i < 3; i++) at[i] = (i < 2 ? -1 : r2) * (N0[i] + u[side] * N1[i]);
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) out.d[3 * i + j] += steep * at[i] * m[j];
            double slide = at[0] * NT[0] + at[1] * NT[1] + at[2] * NT[2];
            out.d[9] += steep * slide * nodes->z[k] - sign * weight * t;
        }
    }
    return out;
}

/* e = w . N by its gradient: with w fixed for a ray, turning about the centre for a circle. */
static line straight(const pixel *p, const double *w, int circle) {
    line out = {0};
    double step[2], across[2], N[3], m[3] = {p->m[0], p->m[1], 1};
    double e = w[0] * p->N[0] + w[1] * p->N[1] + w[2] * p->N[2], g = fmax(gradient(p, w, out.n), 1e-12);
    const double tangent[2] = {-out.n[1], out.n[0]};
    along(p, out.n, step, N);
    out.t = e / (g * p->s);
    double rho = hypot(p->N[0], p->N[1]), a[3] = {w[1], -w[0], 0}; /* along the circle */
    double by_n = circle && rho > 0 ? (a[0] * N[0] + a[1] * N[1]) / rho : 0;
    along(p, tangent, across, N);
    double by_t = circle && rho > 0 ? (a[0] * N[0] + a[1] * N[1]) / rho : 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double steeper = w[i] * (j < 2 ? step[j] : 0) - by_n * a[i] * m[j];
            out.dt[3 * i + j] = w[i] * m[j] / (g * p->s) - out.t * steeper / g;
            out.turn[3 * i + j] = (w[i] * (j < 2 ? across[j] : 0) - by_t * a[i] * m[j]) / g;
        }
    out.dt[9] = -out.t / p->s;
    return out;
}

static share half_plane(const line *l) {
    share out = {fabs(l->t) > REACH ? l->t > 0 : normal(l->t), {0}};
    double f = density(l->t);
    for (int i = 0; i < SLOPES; i++) out.d[i] = f * l->dt[i];
    return out;
}

static share sum(share a, double by, share b) {
    a.v += by * b.v;
    for (int i = 0; i < SLOPES; i++) a.d[i] += by * b.d[i];
    return a;
}

static share product(share a, share b) {
    share out = {a.v * b.v, {0}};
    for (int i = 0; i < SLOPES; i++) out.d[i] = a.d[i] * b.v + a.v * b.d[i];
    return out;
}

static share rest(share a) {
    share one = {1, {0}};
    return sum(one, -1, a);
}

/* What two half planes share beyond the product of their shares: the bivariate normal distribution of correlation
 * r = n . n, less the product, by the integral over the correlation (Z. Drezner, G. Wesolowsky, J. Statist. Comput.
 * Simul. 35, 1990), Gauss and Legendre's rule in its arc sine. */
static share corner(const line *x, const line *y) {
    share out = {0};
    double r = x->n[0] * y->n[0] + x->n[1] * y->n[1], h = x->t, k = y->t;
    r = r > 0.999 ? 0.999 : r < -0.999 ? -0.999 : r;
    if (fabs(h) > REACH || fabs(k) > REACH) return out;
    double half = 0.5 * asin(r), q2 = 1 - r * r, q = sqrt(q2);
    for (int i = 0; i < 8; i++) {
        double sine = sin(half * (1 + node(i)));
        out.v += BY[i & 3] * exp(-0.5 * (h * h + k * k - 2 * h * k * sine) / (1 - sine * sine));
    }
    out.v *= half / (2 * PI);
    double by_h = density(h) * (normal((k - r * h) / q) - normal(k));
    double by_k = density(k) * (normal((h - r * k) / q) - normal(h));
    double by_r = exp(-0.5 * (h * h + k * k - 2 * r * h * k) / q2) / (2 * PI * q);
    double turn = y->n[0] * x->n[1] - y->n[1] * x->n[0]; /* slope of r by the turn of y; by that of x its negative */
    for (int i = 0; i < SLOPES; i++) {
        double dr = i < 9 ? turn * (y->turn[i] - x->turn[i]) : 0;
        out.d[i] = by_h * x->dt[i] + by_k * y->dt[i] + by_r * dr;
    }
    return out;
}

/* The part of a ring, whose share is `whole`, from one ray to another. */
static share part(const cc_mark *mark, const pixel *p, const int32_t *sector, double span, share whole) {
    const double *a = mark->rays + 2 * sector[2], *b = mark->rays + 2 * sector[3];
    const double after[3] = {-a[1], a[0], 0}, before[3] = {b[1], -b[0], 0};
    line first = straight(p, after, 0), last = straight(p, before, 0);
    share one = half_plane(&first), two = half_plane(&last), within;
    const int half = fabs(span - PI) < ROUND;
    if (half) {
        within = one, two.v = 1;
        memset(two.d, 0, sizeof two.d);
    } else if (span < PI) {
        within = sum(product(one, two), 1, corner(&first, &last));
    } else {
        within = sum(sum(sum(one, 1, two), -1, product(one, two)), -1, corner(&first, &last));
    }
    share out = product(whole, within);
    for (int i = 0; i < 2; i++) { /* the corners on the inner and on the outer border */
        if (sector[i] < 0) continue;
        double w[3];
        outward(p, mark->radii[sector[i]], w);
        line circle = straight(p, w, 1);
        if (fabs(circle.t) > REACH) continue;
        double sign = i ? 1 : -1;
        out = sum(out, sign, product(corner(&circle, &first), span < PI + ROUND ? two : rest(two)));
        if (!half) out = sum(out, sign, product(corner(&circle, &last), span < PI ? one : rest(one)));
    }
    return out;
}

static share inked(const cc_mark *mark, const pixel *p, const rule *const *nodes, double steepest, int slopes) {
    share discs[CC_MARK_RADII], out = {0};
    for (int32_t i = 0; i < mark->n_radii; i++) discs[i] = disc(p, mark->radii[i], nodes[i], steepest, slopes);
    for (int32_t i = 0; i < mark->n_sectors; i++) {
        const int32_t *sector = mark->sectors + 4 * i;
        share ring = discs[sector[1]];
        if (sector[0] >= 0) ring = sum(ring, -1, discs[sector[0]]);
        out = sum(out, 1, sector[2] < 0 ? ring : part(mark, p, sector, mark->span[i], ring));
    }
    return out;
}

/* Whether no border comes near the pixel while it moves by up to `away` px: its share of ink stays 0 or 1. */
static int plain(const cc_mark *mark, const pixel *p, double steepest, double away) {
    double w[3];
    for (int32_t i = 0; i < mark->n_sectors; i++)
        if (mark->sectors[4 * i + 2] >= 0) return 0; /* borders towards the centre, too */
    for (int32_t i = 0; i < mark->n_radii; i++) {
        outward(p, mark->radii[i], w);
        double e = w[0] * p->N[0] + w[1] * p->N[1] + w[2] * p->N[2];
        if (!(fabs(e) > (REACH * p->s + away) * steepest)) return 0;
    }
    return 1;
}

/* The mean share along the motion d, and its slopes by d: the pixel sees what was at q - t d, t in [-1/2, 1/2]. */
static share smeared(const cc_mark *mark, const pixel *p, const rule *const *nodes, double steepest, int slopes,
                     const double *d, double *by_d) {
    share out = {0};
    double step[2], N[3], toward[2][3];
    const double x[2] = {1, 0}, y[2] = {0, 1};
    by_d[0] = by_d[1] = 0;
    if (plain(mark, p, steepest, 0.5 * hypot(d[0], d[1]))) return inked(mark, p, nodes, steepest, slopes);
    along(p, x, step, toward[0]), along(p, y, step, toward[1]), along(p, d, step, N);
    const int panels = (int)fmin(fmax(ceil(hypot(d[0], d[1]) / (PANEL * p->s)), 1), 64);
    for (int k = 0; k < 8 * panels; k++) {
        double t = (2 * (k / 8) + 1 + node(k % 8)) / (2 * panels) - 0.5, weight = BY[k & 3] / (2 * panels);
        pixel there = *p;
        for (int i = 0; i < 2; i++) there.m[i] -= t * step[i];
        for (int i = 0; i < 3; i++) there.N[i] -= t * N[i];
        share one = inked(mark, &there, nodes, steepest, slopes);
        out = sum(out, weight, one);
        for (int j = 0; j < 2; j++) /* the third column of H moves the whole neighbourhood */
            for (int i = 0; i < 3; i++) by_d[j] -= t * weight * one.d[3 * i + 2] * toward[j][i];
    }
    return out;
}

void cc_mark_picture(const cc_mark *mark, int64_t marks, int64_t pixels, int32_t width, const double *places,
                     const double *weight, const double *H, int32_t terms, const double *dH, const double *levels,
                     int32_t loose, double *value, double *slopes) {
    for (int64_t b = 0; b < marks; b++, H += 9, dH += 9 * terms, levels += 8) {
        const double c = levels[0], s = levels[1], m = levels[2], gx = levels[3], gy = levels[4], bend = levels[5];
        const double *d = levels + 6;
        const rule *nodes[CC_MARK_RADII];
        double large, small, tallest = 0;
        stretches(H[0], H[1], H[3], H[4], &large, &small);
        for (int32_t i = 0; i < mark->n_radii; i++) { /* the smallest radius of curvature of an ellipse is b^2 / a */
            double bent = s * large * large / fmax(small * mark->radii[i], 1e-12);
            int level = bent < BENT[0] ? 0 : bent < BENT[1] ? 1 : bent < BENT[2] ? 2 : 3;
            nodes[i] = &RULES[level], tallest = fmax(tallest, mark->radii[i]);
        }
        for (int64_t k = 0; k < pixels; k++, places += width) {
            if (weight && *weight++ == 0) {
                *value++ = 0;
                if (slopes) memset(slopes, 0, (terms + 5 + loose) * sizeof *slopes), slopes += terms + 5 + loose;
                continue;
            }
            const double u = places[0], v = places[1], *x = width == 8 ? places + 2 : places;
            pixel p = {H, {x[0], x[1]}, {{1, 0}, {0, 1}}, {0}, s};
            double steepest = large + tallest * hypot(H[6], H[7]);
            if (width == 8) {
                memcpy(p.L, places + 4, sizeof p.L);
                steepest *= sqrt(p.L[0][0] * p.L[0][0] + p.L[0][1] * p.L[0][1]
                                 + p.L[1][0] * p.L[1][0] + p.L[1][1] * p.L[1][1]);
            }
            for (int i = 0; i < 3; i++) p.N[i] = H[3 * i] * x[0] + H[3 * i + 1] * x[1] + H[3 * i + 2];
            double by_d[2] = {0, 0};
            share ink = d[0] == 0 && d[1] == 0 ? inked(mark, &p, nodes, steepest, slopes != NULL)
                                               : smeared(mark, &p, nodes, steepest, slopes != NULL, d, by_d);
            double mixed = ink.v * (1 - ink.v), shown = ink.v + bend * mixed, steep = 1 + bend * (1 - 2 * ink.v);
            double light = 1 + gx * u + gy * v, level = m + c * shown;
            *value++ = level * light;
            if (!slopes) continue;
            for (int32_t t = 0; t < terms; t++) {
                double slope = 0;
                for (int i = 0; i < 9; i++) slope += dH[9 * t + i] * ink.d[i];
                slopes[t < 4 ? t : t + 5] = c * light * steep * slope;
            }
            const double last[5] = {shown * light, c * light * steep * ink.d[9], light, level * u, level * v};
            memcpy(slopes + 4, last, sizeof last);
            const double rest[3] = {c * light * mixed, c * light * steep * by_d[0], c * light * steep * by_d[1]};
            memcpy(slopes + terms + 5, rest, loose * sizeof *rest);
            slopes += terms + 5 + loose;
        }
    }
}
