/* Least squares of grouped data: see grouped.h.
 *
 * With r = (J_i, y_i) the sums of w r r' over all data, and those of w r over each group, are sufficient: an offset of
 * variance v subtracts f s s' from the former for each group, s its sum and f = v / (1 + v sum w). The rest of s,
 * s / (1 + v sum w), adds to the sums of the family, whose offset is eliminated in the same way. The result is
 * factored, y's row last, which gives the solution, the misfit and the determinant at once.
 */
#include "grouped.h"

#include <math.h>
#include <string.h>

#include "internal.h"

enum { WIDE = CC_UNKNOWNS + 1, PACKED = WIDE * (WIDE + 1) / 2 };
#define OPEN 1e-12   /* share of a parameter's square not explained by others, below which it is undetermined */
#define RIDGE 1e-13  /* of each square */
#define LEAST 1e-300
#define HIGH 1e150   /* two numbers up to it, or down to its inverse, may be multiplied */
#define HARDLY 1e-12 /* of the greatest likelihood: less likely ones are left out of the mean */

/* Sums of groups or families: of the weights, of w r, and the products of the latter, lower half row by row. */
typedef struct {
    double *total, *sum, *square;
} sums;

/* The logarithm of a product, with few calls of log. */
typedef struct {
    double log, product;
} logs;

static void times(logs *of, double factor, double power) {
    if (power == 1 && factor < HIGH && factor > 1 / HIGH) {
        of->product *= factor;
        if (of->product > HIGH || of->product < 1 / HIGH) of->log += log(of->product), of->product = 1;
    } else of->log += power * log(factor);
}

static void squares(const sums *g, int64_t n, int32_t wide) {
    double *square = g->square;
    for (int64_t of = 0; of < n; of++) {
        const double *sum = g->sum + of * wide;
        for (int32_t a = 0; a < wide; a++)
            for (int32_t b = 0; b <= a; b++) *square++ = sum[a] * sum[b];
    }
}

static void add_up(const cc_grouped *d, const sums *g, double *all) {
    const int32_t wide = d->k + 1, packed = wide * (wide + 1) / 2;
    memset(all, 0, sizeof(double) * (size_t)packed);
    memset(g->total, 0, sizeof(double) * (size_t)d->groups);
    memset(g->sum, 0, sizeof(double) * (size_t)(d->groups * wide));
    for (int64_t i = 0; i < d->n; i++) {
        const int64_t of = d->group[i];
        const double w = d->w[i] * d->of_group[of];
        double r[WIDE], *sum = g->sum + of * wide;
        memcpy(r, d->J + i * d->k, sizeof(double) * (size_t)d->k);
        r[d->k] = d->y[i], g->total[of] += w;
        for (int32_t a = 0, s = 0; a < wide; a++) {
            const double wr = w * r[a];
            sum[a] += wr;
            for (int32_t b = 0; b <= a; b++) all[s++] += wr * r[b];
        }
    }
    squares(g, d->groups, wide);
}

/* Add a share of a group's sums, the rest after elimination, to those of its family. */
static void add_to_family(const cc_grouped *d, const sums *g, int64_t of, double share, const sums *family) {
    const int32_t wide = d->k + 1;
    const double *sum = g->sum + of * wide;
    double *families = family->sum + d->family[of] * wide;
    for (int32_t a = 0; a < wide; a++) families[a] += share * sum[a];
    family->total[d->family[of]] += share * g->total[of];
}

/* Eliminate the groups' offsets from the sums, also from those of families unless that is null; returns their
 * contribution to the log of the determinant. */
static double without_groups(const cc_grouped *d, const sums *g, int32_t t, const double *all, double *left,
                             const sums *family) {
    const int32_t wide = d->k + 1, packed = wide * (wide + 1) / 2;
    logs added = {0, 1};
    memcpy(left, all, sizeof(double) * (size_t)packed);
    if (family) memset(family->total, 0, sizeof(double) * (size_t)d->families);
    if (family) memset(family->sum, 0, sizeof(double) * (size_t)(d->families * wide));
    for (int64_t of = 0; of < d->groups; of++) {
        const double v = d->variance[t] * d->free[of] + d->share[t] * d->expected[of];
        const double counts = d->of_group[of] > 1e-12 ? d->of_group[of] : 1e-12, total = g->total[of];
        const double grown = v > 0 && total > 0 ? 1 + v * total / counts : 1;
        if (family) add_to_family(d, g, of, 1 / grown, family);
        if (grown == 1) continue;
        const double f = v / grown / counts, *square = g->square + of * packed;
        for (int32_t s = 0; s < packed; s++) left[s] -= f * square[s];
        times(&added, grown, counts);
    }
    if (family) squares(family, d->families, wide);
    return added.log + log(added.product);
}

/* The same where families have offsets too. */
static double without_families(const cc_grouped *d, const sums *family, int32_t u, const double *all, double *left) {
    const int32_t packed = (d->k + 1) * (d->k + 2) / 2;
    logs added = {0, 1};
    memcpy(left, all, sizeof(double) * (size_t)packed);
    if (!(d->family_variance[u] > 0)) return 0;
    for (int64_t of = 0; of < d->families; of++) {
        const double v = d->family_variance[u] * d->family_free[of], total = family->total[of];
        if (!(v > 0 && total > 0)) continue;
        const double grown = 1 + v * total, f = v / grown, *square = family->square + of * packed;
        for (int32_t s = 0; s < packed; s++) left[s] -= f * square[s];
        times(&added, grown, 1);
    }
    return added.log + log(added.product);
}

/* Factor the packed sums of J, y after scaling; the log likelihood; 0 where J's are singular. */
static int factored(const double *left, int k, double L[WIDE][WIDE], double *scale, double *likelihood) {
    logs det = {0, 1};
    const double *row = left;
    for (int i = 0; i <= k; row += ++i) {
        const double own = row[i] > LEAST ? row[i] : LEAST;
        scale[i] = i < k ? sqrt(own) : 1;
        for (int j = 0; j < i; j++) {
            double s = row[j] / (scale[i] * scale[j]);
            for (int m = 0; m < j; m++) s -= L[i][m] * L[j][m];
            L[i][j] = s / L[j][j];
        }
        double s = i < k ? 1 + RIDGE : row[i];
        for (int m = 0; m < i; m++) s -= L[i][m] * L[i][m];
        if (i == k) *likelihood = -0.5 * s - det.log - log(det.product);
        else if (!(s > OPEN)) return 0;
        else L[i][i] = sqrt(s), times(&det, scale[i] * L[i][i], 1);
    }
    return 1;
}

/* x (k) and the inverse (k, k) of J's sums. */
static void solved(int k, double L[WIDE][WIDE], const double *scale, double *x, double *inverse) {
    double R[WIDE][WIDE];
    for (int i = k - 1; i >= 0; i--) {
        double s = L[k][i];
        for (int m = i + 1; m < k; m++) s -= L[m][i] * x[m];
        x[i] = s / L[i][i];
    }
    for (int j = 0; j < k; j++)
        for (int i = j; i < k; i++) {
            double s = i == j;
            for (int m = j; m < i; m++) s -= L[i][m] * R[m][j];
            R[i][j] = s / L[i][i];
        }
    for (int i = 0; i < k; i++) {
        x[i] /= scale[i];
        for (int j = 0; j <= i; j++) {
            double s = 0;
            for (int m = i; m < k; m++) s += R[m][i] * R[m][j];
            inverse[i * k + j] = inverse[j * k + i] = s / (scale[i] * scale[j]);
        }
    }
}

/* The mean over the grid and its covariance: the mean within plus the scatter between its points. */
static void averaged(int32_t tried, int32_t k, const double *left, const double *p, double *each_x, double *x,
                     double *covariance) {
    const int32_t packed = (k + 1) * (k + 2) / 2;
    double L[WIDE][WIDE], scale[WIDE], inverse[CC_UNKNOWNS * CC_UNKNOWNS], likelihood;
    memset(x, 0, sizeof(double) * (size_t)k), memset(covariance, 0, sizeof(double) * (size_t)(k * k));
    for (int32_t t = 0; t < tried; t++) {
        if (!(p[t] > 0)) continue;
        factored(left + t * packed, k, L, scale, &likelihood);
        solved(k, L, scale, each_x + t * k, inverse);
        for (int32_t i = 0; i < k; i++) x[i] += p[t] * each_x[t * k + i];
        for (int32_t i = 0; i < k * k; i++) covariance[i] += p[t] * inverse[i];
    }
    for (int32_t t = 0; t < tried; t++) {
        if (!(p[t] > 0)) continue;
        for (int32_t i = 0; i < k; i++)
            for (int32_t j = 0; j < k; j++)
                covariance[i * k + j] += p[t] * (each_x[t * k + i] - x[i]) * (each_x[t * k + j] - x[j]);
    }
}

/* Lay out the sums of groups and families in scratch; returns the memory after them. */
static double *laid_out(const cc_grouped *d, double *scratch, sums *groups, sums *families) {
    const int64_t wide = d->k + 1, own = 1 + wide + wide * (wide + 1) / 2;
    double *next = scratch + d->groups * own;
    *groups = (sums){scratch, scratch + d->groups, scratch + d->groups * (1 + wide)};
    *families = (sums){next, next + d->families, next + d->families * (1 + wide)};
    return next + d->families * own;
}

/* Normalise likelihoods p, given as logarithms up to a constant, to a sum of 1; 0 where there are none. */
static int likely(int32_t tried, double *p) {
    double most = -INFINITY, sum = 0;
    for (int32_t t = 0; t < tried; t++) most = p[t] > most ? p[t] : most;
    for (int32_t t = 0; t < tried; t++) p[t] = p[t] - most > log(HARDLY) ? exp(p[t] - most) : 0, sum += p[t];
    for (int32_t t = 0; t < tried; t++) p[t] /= sum;
    return sum > 0;
}

int32_t cc_grouped_fit(const cc_grouped *d, double *scratch, double *p, double *x, double *covariance,
                       cc_apart *apart) {
    const int32_t k = d->k, packed = (k + 1) * (k + 2) / 2, tried = d->tried * d->family_tried;
    sums groups, families;
    double *left = laid_out(d, scratch, &groups, &families), *each_x = left + (int64_t)tried * packed;
    double all[PACKED], some[PACKED], L[WIDE][WIDE], scale[WIDE];
    const sums *asked = NULL; /* without family offsets at any grid point, their sums are not needed */
    for (int32_t u = 0; u < d->family_tried; u++)
        if (d->family_variance[u] > 0) asked = &families;
    add_up(d, &groups, all);
    for (int32_t t = 0, at = 0; t < d->tried; t++) {
        const double log_groups = without_groups(d, &groups, t, all, some, asked);
        for (int32_t u = 0; u < d->family_tried; u++, at++) {
            double *here = left + (int64_t)at * packed;
            const double log_families = without_families(d, &families, u, some, here);
            if (!factored(here, k, L, scale, p + at)) return 0;
            p[at] += d->prior[t] + d->family_prior[u] - 0.5 * (log_groups + log_families);
        }
    }
    if (!likely(tried, p)) return 0;
    averaged(tried, k, left, p, each_x, x, covariance);
    *apart = (cc_apart){0, 0, 0};
    for (int32_t at = 0; at < tried; at++) {
        const int32_t t = at / d->family_tried;
        apart->own += p[at] * d->variance[t], apart->share += p[at] * d->share[t];
        apart->alike += p[at] * d->family_variance[at % d->family_tried];
    }
    return 1;
}

void cc_weighed(const cc_grouped *d, double *scratch, const cc_apart *apart, double *weighed) {
    const int32_t k = d->k, wide = k + 1;
    sums g, family;
    laid_out(d, scratch, &g, &family);
    memset(family.total, 0, sizeof(double) * (size_t)d->families);
    memset(family.sum, 0, sizeof(double) * (size_t)(d->families * wide));
    for (int pass = 0; pass < 2; pass++) /* the sums of families, then the groups' shares in them */
        for (int64_t of = 0; of < d->groups; of++) {
            const int64_t in = d->family[of];
            const double counts = d->of_group[of] > 1e-12 ? d->of_group[of] : 1e-12;
            const double own = (apart->own * d->free[of] + apart->share * d->expected[of]) / counts;
            const double grown = 1 + own * g.total[of], v = apart->alike * d->family_free[in];
            double *sum = g.sum + of * wide, *common = family.sum + in * wide;
            if (pass == 0) family.total[in] += g.total[of] / grown;
            for (int32_t a = 0; a < k; a++) {
                if (pass == 0) common[a] += sum[a] / grown;
                else sum[a] = (own * sum[a] + v / (1 + v * family.total[in]) * common[a]) / grown;
            }
        }
    for (int64_t i = 0; i < d->n; i++) {
        const double w = d->w[i] * d->of_group[d->group[i]], *taken = g.sum + d->group[i] * wide;
        for (int32_t a = 0; a < k; a++) weighed[i * k + a] = w * (d->J[i * k + a] - taken[a]);
    }
}
