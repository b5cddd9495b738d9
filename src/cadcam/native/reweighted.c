/* Iteratively reweighted regression of grouped data: see grouped.h. */
#include "grouped.h"

#include <math.h>
#include <string.h>

#define FULL 2.5      /* standard deviations: up to here a datum counts fully, */
#define NONE 4.0      /* from here on not at all */
#define SETTLED 0.02  /* standard deviations: change of x at convergence */
#define MEDIAN 0.455  /* median of the square of a standard normal variable */
#define LEAST 1e-300

/* What changes from round to round: for each datum its weight, residual and variance; room for n. */
typedef struct {
    double *w, *rest, *variance, *room;
} state;

static double counts(double deviations) { return fmin(fmax((NONE - fabs(deviations)) / (NONE - FULL), 0), 1); }

/* The median of numbers, which are reordered (C. A. R. Hoare, Algorithm 65: FIND, 1961). */
static double median(double *v, int64_t n) {
    const int64_t middle = (n - 1) / 2;
    for (int64_t low = 0, high = n - 1; low < high;) {
        const double pivot = v[low + (high - low) / 2];
        int64_t i = low, j = high;
        while (i <= j) {
            while (v[i] < pivot) i++;
            while (v[j] > pivot) j--;
            if (i > j) break;
            const double other = v[i];
            v[i++] = v[j], v[j--] = other;
        }
        if (middle <= j) high = j;
        else if (middle >= i) low = i;
        else break;
    }
    if (n % 2) return v[middle];
    double next = v[middle + 1];
    for (int64_t i = middle + 2; i < n; i++) next = fmin(next, v[i]);
    return 0.5 * (v[middle] + next);
}

/* The variance of the good half of n deviations' squares, 0 of none. */
static double good_half(double *squares, int64_t n) { return n ? median(squares, n) / MEDIAN : 0; }

/* The weighted mean of each group and its total weight. */
static void means(const cc_grouped *d, const double *y, const double *w, double *mean, double *total) {
    memset(mean, 0, sizeof(double) * (size_t)d->groups), memset(total, 0, sizeof(double) * (size_t)d->groups);
    for (int64_t i = 0; i < d->n; i++) mean[d->group[i]] += w[i] * y[i], total[d->group[i]] += w[i];
    for (int64_t g = 0; g < d->groups; g++) mean[g] /= fmax(total[g], LEAST);
}

/* The variance of the good half of the groups that scatter. */
static double between(const cc_reweighted *asked, const cc_found *f, double *room) {
    int64_t several = 0;
    for (int64_t g = 0; g < asked->of.groups; g++)
        if (asked->scatter[g] > 0) room[several++] = f->mean[g] * f->mean[g];
    return good_half(room, several);
}

/* Initial weights of data and groups, and the spread within groups, from medians at x = 0. */
static void first_weights(const cc_reweighted *asked, const state *s, cc_found *f) {
    const cc_grouped *d = &asked->of;
    int64_t several = 0;
    for (int64_t i = 0; i < d->n; i++) s->w[i] = 1 / asked->known[i];
    means(d, d->y, s->w, f->mean, f->total);
    for (int64_t i = 0; i < d->n; i++) {
        const double off = d->y[i] - f->mean[d->group[i]];
        if (asked->scatter[d->group[i]] > 0) s->room[several++] = off * off;
    }
    f->within2 = good_half(s->room, several);
    for (int64_t i = 0; i < d->n; i++) s->w[i] = 1 / (asked->known[i] + f->within2);
    means(d, d->y, s->w, f->mean, f->total);
    for (int64_t i = 0; i < d->n; i++) {
        const int64_t g = d->group[i];
        f->counts[i] = asked->scatter[g] > 0 ? counts((d->y[i] - f->mean[g]) * sqrt(s->w[i])) : 1;
    }
    const double usual = sqrt(fmax(between(asked, f, s->room), LEAST));
    for (int64_t g = 0; g < d->groups; g++) f->of_group[g] = asked->scatter[g] > 0 ? counts(f->mean[g] / usual) : 1;
}

/* The variance of data within their group: the known one plus the spread. */
static void grow(const cc_reweighted *asked, const cc_found *f, double *variance) {
    for (int64_t i = 0; i < asked->of.n; i++) {
        const double scatter = asked->scatter[asked->of.group[i]];
        variance[i] = asked->known[i] * (1 + f->excess * scatter) + f->within2 * scatter;
    }
}

/* Excess and variance within groups beyond the known one: those for which the weighted squares equal their expectation,
 * allowing for the part of a datum's variance that its group's mean absorbs. */
static void spread(const cc_reweighted *asked, const state *s, cc_found *f) {
    double a = 0, b = 0, c = 0, p = 0, q = 0;
    for (int64_t i = 0; i < asked->of.n; i++) {
        const int64_t g = asked->of.group[i];
        const double weight = f->counts[i] * asked->scatter[g] / (s->variance[i] * s->variance[i]);
        const double left = weight * (1 - s->w[i] / fmax(f->total[g], LEAST)), known = asked->known[i];
        const double off = s->rest[i] - f->mean[g], beyond = weight * off * off - left * known;
        a += left * known * known, b += left * known, c += left, p += beyond * known, q += beyond;
    }
    f->excess = f->within2 = 0;
    if (!(c > 0)) return;
    const double det = a * c - b * b;
    if (det > 1e-9 * a * c && c * p - b * q >= 0 && a * q - b * p >= 0) {
        f->excess = (c * p - b * q) / det, f->within2 = (a * q - b * p) / det;
        return;
    }
    p = fmax(p, 0), q = fmax(q, 0);
    if (p * p / a >= q * q / c) f->excess = p / a;
    else f->within2 = q / c;
}

/* The variance of each group's offset: its own and its family's. */
static void offsets(const cc_grouped *d, cc_found *f) {
    for (int64_t g = 0; g < d->groups; g++)
        f->off[g] = f->apart.own * d->free[g] + f->apart.share * d->expected[g]
                    + f->apart.alike * d->family_free[d->family[g]];
}

/* The weights of data and groups, from their residuals. */
static void reweigh(const cc_reweighted *asked, const state *s, cc_found *f) {
    const cc_grouped *d = &asked->of;
    for (int64_t i = 0; i < d->n; i++) {
        const int64_t g = d->group[i];
        const double its = f->off[g] / (f->off[g] + 1 / fmax(f->total[g], LEAST));
        f->counts[i] = counts(asked->scatter[g] * (s->rest[i] - f->mean[g] * its) / sqrt(s->variance[i]));
    }
    for (int64_t g = 0; g < d->groups; g++)
        f->of_group[g] = counts(asked->scatter[g] * f->mean[g] / sqrt(f->off[g] + 1 / fmax(f->total[g], LEAST)));
}

static int settled(int32_t k, const double *before, const cc_found *f) {
    for (int32_t a = 0; a < k; a++)
        if (!(fabs(f->x[a] - before[a]) <= SETTLED * sqrt(f->covariance[a * k + a]))) return 0;
    return 1;
}

CC_API int32_t cc_reweighted_fit(const cc_reweighted *asked, double *scratch, cc_found *f) {
    cc_grouped d = asked->of;
    const int64_t n = d.n, tried = (int64_t)d.tried * d.family_tried;
    double *p = scratch, *of_group = p + tried, *before = of_group + d.groups, *sums = before + d.k + 4 * n;
    const state s = {before + d.k, before + d.k + n, before + d.k + 2 * n, before + d.k + 3 * n};
    f->excess = f->within2 = 0;
    memset(f->x, 0, sizeof(double) * (size_t)d.k);
    for (int64_t i = 0; i < n; i++) f->counts[i] = 1;
    if (asked->robust) first_weights(asked, &s, f);
    else memcpy(f->of_group, d.of_group, sizeof(double) * (size_t)d.groups);
    d.w = s.w, d.of_group = of_group;
    grow(asked, f, s.variance);
    for (int32_t round = 0; round < asked->rounds; round++) {
        for (int64_t i = 0; i < n; i++) s.w[i] = f->counts[i] / s.variance[i];
        memcpy(of_group, f->of_group, sizeof(double) * (size_t)d.groups);
        memcpy(before, f->x, sizeof(double) * (size_t)d.k);
        if (!cc_grouped_fit(&d, sums, p, f->x, f->covariance, &f->apart)) return 0;
        for (int64_t i = 0; i < n; i++) {
            s.rest[i] = d.y[i];
            for (int32_t a = 0; a < d.k; a++) s.rest[i] -= d.J[i * d.k + a] * f->x[a];
        }
        means(&d, s.rest, s.w, f->mean, f->total), offsets(&d, f);
        spread(asked, &s, f);
        const double off2 = fmin(f->apart.own + f->apart.alike, between(asked, f, s.room));
        f->within2 = fmax(f->within2, asked->uneven * asked->uneven * off2);
        if (settled(d.k, before, f)) break;
        grow(asked, f, s.variance);
        if (asked->robust) reweigh(asked, &s, f);
    }
    cc_weighed(&d, sums, &f->apart, f->weighed);
    return 1;
}
