/* Steps beside lines in the residuals of step fits: cc_band_gains of profile.h. */
#include <math.h>
#include <stdlib.h>

#include "profile.h"

enum { OWN = 5, TERMS = OWN + CC_BAND_KNOWN };
#define ROOT_HALF 0.70710678118654752
#define OF_BELL 0.39894228040143268 /* 1 / sqrt(2 pi) */
#define FAR 7.0 /* blurs beyond which a step is constant */
#define HARDLY 1e-3 /* share of all pixels below which a step is explained by the known terms */

/* A unit step at a place beside the line, rising away from the line. */
static double beyond(double d, double place, double blur) {
    const double x = (place < 0 ? place - d : d - place) / blur;
    return fabs(x) < FAR ? 0.5 * erfc(-ROOT_HALF * x) : x > 0;
}

/* Level, step, its bell, and the ramps below and above at a distance, as cc_steps fits them. */
static void own_terms(double d, double blur, double *f) {
    const double step = 0.5 * erfc(-ROOT_HALF * d / blur), bell = OF_BELL / blur * exp(-0.5 * d * d / (blur * blur));
    f[0] = 1, f[1] = step, f[2] = bell, f[4] = d * step + blur * blur * bell, f[3] = d - f[4];
}

/* Solve L x = y in place, without the rows of zero information. */
static void forward(double L[TERMS][TERMS], double *y) {
    for (int i = 0; i < TERMS; i++) {
        for (int k = 0; k < i; k++) y[i] -= L[i][k] * y[k];
        y[i] *= L[i][i];
    }
}

/* Cholesky factor of the terms' products, its diagonal inverted: 0 for a term that depends on those before. */
static void factor(double L[TERMS][TERMS]) {
    for (int i = 0; i < TERMS; i++) {
        const double whole = L[i][i];
        for (int j = 0; j <= i; j++) {
            for (int k = 0; k < j; k++) L[i][j] -= L[i][k] * L[j][k];
            if (j < i) L[i][j] *= L[j][j];
        }
        L[i][i] = L[i][i] > 1e-6 * whole ? 1 / sqrt(L[i][i]) : 0;
    }
}

/* Gains in one stretch: f (bins, TERMS), its terms; u (tries, bins), the steps tried. */
static void gains(int32_t bins, const double (*f)[TERMS], const double *rest, const double *number, double variance,
                  const double *room, int32_t tries, const double *tried, const double (*u)[CC_BAND_BINS],
                  double *gain) {
    double L[TERMS][TERMS] = {{0}}, weighted[CC_BAND_BINS][TERMS], right[TERMS] = {0}, pixels = 0;
    for (int32_t b = 0; b < bins; b++) {
        pixels += number[b];
        for (int k = 0; k < TERMS; k++) weighted[b][k] = number[b] * f[b][k], right[k] += f[b][k] * rest[b];
        for (int k = 0; k < TERMS; k++)
            for (int j = 0; j < TERMS; j++) L[k][j] += weighted[b][k] * f[b][j];
    }
    factor(L), forward(L, right);
    for (int32_t t = 0; t < tries; t++) {
        gain[t] = 0;
        if (!(fabs(tried[t]) < room[tried[t] > 0])) continue;
        double with[TERMS] = {0}, left = 0, seen = 0;
        for (int32_t b = 0; b < bins; b++) {
            left += number[b] * u[t][b] * u[t][b], seen += rest[b] * u[t][b];
            for (int k = 0; k < TERMS; k++) with[k] += weighted[b][k] * u[t][b];
        }
        forward(L, with);
        for (int k = 0; k < TERMS; k++) left -= with[k] * with[k], seen -= with[k] * right[k];
        if (left > HARDLY * pixels && variance > 0) gain[t] = seen * seen / (left * variance);
    }
}

CC_API int32_t cc_band_gains(int64_t n, int32_t bins, double width, double blur, const double *rest,
                             const double *number, const double *variance, const double *known, const double *room,
                             int32_t tries, const double *tried, double *gain) {
    double(*const u)[CC_BAND_BINS] = calloc((size_t)tries + 1, sizeof *u), f[CC_BAND_BINS][TERMS] = {{0}};
    if (!u) return 0;
    const double first = 0.5 * (1 - bins) * width;
    for (int32_t b = 0; b < bins; b++) {
        own_terms(first + b * width, blur, f[b]);
        for (int32_t t = 0; t < tries; t++) u[t][b] = beyond(first + b * width, tried[t], blur);
    }
    for (int64_t i = 0; i < n; i++) {
        for (int k = 0; k < CC_BAND_KNOWN; k++) {
            const double place = known[i * CC_BAND_KNOWN + k];
            for (int32_t b = 0; b < bins; b++)
                f[b][OWN + k] = isfinite(place) ? beyond(first + b * width, place, blur) : 0;
        }
        gains(bins, (const double(*)[TERMS])f, rest + i * bins, number + i * bins, variance[i], room + 2 * i, tries,
              tried, (const double(*)[CC_BAND_BINS])u, gain + i * tries);
    }
    free(u);
    return 1;
}
