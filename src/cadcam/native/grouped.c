/* Least squares of data that err in groups: see grouped.h.
 *
 * With r = (J_i, y_i) the sums of w r r' over all data, and those of w r over each group, say everything: an offset of
 * variance v takes f s s' from the former for each group, s its sum and f = v / (1 + v sum w). What is left is
 * factored, y's row last: that gives the solution, the misfit and the determinant at once.
 */
#include "grouped.h"

#include <math.h>
#include <string.h>

#include "internal.h"

enum { WIDE = CC_UNKNOWNS + 1, PACKED = WIDE * (WIDE + 1) / 2 };
#define OPEN 1e-12   /* what others leave of a parameter's own square, below which it is open */
#define RIDGE 1e-13  /* of each square */
#define LEAST 1e-300
#define HIGH 1e200   /* numbers up to it may be multiplied by one up to 1e100 */

/* Sums of a group: of the weights, of w r, and the products of the latter, lower half row by row. */
typedef struct {
    double *total, *sum, *square;
} groups;

static void add_up(const cc_grouped *d, const groups *g, double *all) {
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
    for (int64_t of = 0; of < d->groups; of++) {
        const double *sum = g->sum + of * wide;
        double *square = g->square + of * packed;
        for (int32_t a = 0; a < wide; a++)
            for (int32_t b = 0; b <= a; b++) *square++ = sum[a] * sum[b];
    }
}

/* What is left of the sums where groups have offsets; returns the log of the determinant that these add. */
static double without_offsets(const cc_grouped *d, const groups *g, int32_t t, const double *all, double *left) {
    const int32_t packed = (d->k + 1) * (d->k + 2) / 2;
    double logs = 0, product = 1;
    memcpy(left, all, sizeof(double) * (size_t)packed);
    for (int64_t of = 0; of < d->groups; of++) {
        const double v = d->variance[t] * d->free[of] + d->share[t] * d->expected[of];
        const double counts = d->of_group[of] > 1e-12 ? d->of_group[of] : 1e-12, total = g->total[of];
        if (!(v > 0 && total > 0)) continue;
        const double grown = 1 + v * total / counts, f = v / grown / counts, *square = g->square + of * packed;
        for (int32_t s = 0; s < packed; s++) left[s] -= f * square[s];
        if (counts == 1 && grown < 1e100) { /* one logarithm for many */
            product *= grown;
            if (product > HIGH) logs += log(product), product = 1;
        } else logs += counts * log(grown);
    }
    return logs + log(product);
}

/* Factor the packed sums of J, y; x (k), the inverse (k, k) of J's, the log likelihood; 0 where J's are singular. */
static int solved(const double *left, int k, double *x, double *inverse, double *likelihood) {
    double L[WIDE][WIDE], R[WIDE][WIDE], scale[WIDE], log_det = 0;
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
        if (i == k) *likelihood = -0.5 * (s + log_det);
        else if (!(s > OPEN)) return 0;
        else L[i][i] = sqrt(s), log_det += 2 * log(scale[i] * L[i][i]);
    }
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
    return 1;
}

/* The mean of what was tried and its covariance: of each, and between them. */
static void averaged(int32_t tried, int32_t k, const double *each_x, const double *each_inverse, const double *p,
                     double *x, double *covariance) {
    memset(x, 0, sizeof(double) * (size_t)k), memset(covariance, 0, sizeof(double) * (size_t)(k * k));
    for (int32_t t = 0; t < tried; t++)
        for (int32_t i = 0; i < k; i++) x[i] += p[t] * each_x[t * k + i];
    for (int32_t t = 0; t < tried; t++)
        for (int32_t i = 0; i < k; i++)
            for (int32_t j = 0; j < k; j++)
                covariance[i * k + j] += p[t] * (each_inverse[(t * k + i) * k + j] +
                                                 (each_x[t * k + i] - x[i]) * (each_x[t * k + j] - x[j]));
}

CC_API int32_t cc_grouped_fit(const cc_grouped *d, double *scratch, double *x, double *covariance, double *p) {
    const int32_t k = d->k, wide = k + 1, packed = wide * (wide + 1) / 2;
    const groups g = {scratch, scratch + d->groups, scratch + d->groups * (1 + wide)};
    double *each_x = g.square + d->groups * packed, *each_inverse = each_x + d->tried * k;
    double all[PACKED], left[PACKED], most = -INFINITY, sum = 0;
    add_up(d, &g, all);
    for (int32_t t = 0; t < d->tried; t++) {
        const double logs = without_offsets(d, &g, t, all, left);
        if (!solved(left, k, each_x + t * k, each_inverse + t * k * k, p + t)) return 0;
        p[t] += d->prior[t] - 0.5 * logs;
        most = p[t] > most ? p[t] : most;
    }
    for (int32_t t = 0; t < d->tried; t++) p[t] = exp(p[t] - most), sum += p[t];
    for (int32_t t = 0; t < d->tried; t++) p[t] /= sum;
    averaged(d->tried, k, each_x, each_inverse, p, x, covariance);
    return 1;
}
