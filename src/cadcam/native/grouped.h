/* Least squares of data that err in groups, for every variance between groups at once: see cadcam/fit/grouped.py.
 *
 * Plain C11 like raster.h; every function writes its answers into memory of the caller.
 */
#ifndef CADCAM_GROUPED_H
#define CADCAM_GROUPED_H

#include <stdint.h>

#include "raster.h"

#define CC_UNKNOWNS 64 /* at most */

/* y (n) = J (n, k) x with weights w (n) and group numbers from 0 on, ascending. Groups count of_group (groups,) times,
 * 0 to 1. The variance between groups that is tried is variance[t] free[g] + share[t] expected[g], with log likelihood
 * prior[t] beforehand. Groups belong to families, numbers from 0 on, ascending; between these it is family_variance[u]
 * family_free[f], with log likelihood family_prior[u]. All t are tried with all u. */
typedef struct {
    const double *y, *J, *w;
    const int64_t *group, *family;
    const double *of_group, *free, *expected;
    const double *variance, *share, *prior;
    const double *family_free, *family_variance, *family_prior;
    int64_t n, groups, families;
    int32_t k, tried, family_tried;
} cc_grouped;

/* Means of the variance, of its share of what is expected and of the family_variance, by how likely each is. */
typedef struct {
    double own, share, alike;
} cc_apart;

/* The same with weights that are found round by round, from variances known (n) of the data and those that show within
 * and between groups; data scatter (groups) 1 or 0 within theirs. At least `uneven` of what groups are off by is taken
 * to be within them. Weighted by how far each datum is off, first as seen from x = 0, if robust. */
typedef struct {
    cc_grouped of; /* but for w: of_group as it begins, if not robust */
    const double *known, *scatter;
    double uneven;
    int32_t robust, rounds;
} cc_reweighted;

/* What is found: x (k), its covariance (k, k); how far data (n) and groups count; the mean (groups) of what is left of
 * each group, the weight (groups) behind it and the variance (groups) that it is taken to have; weighed (n, k), by
 * which W y is summed up: x = (weighed' J)^-1 weighed' y. */
typedef struct {
    double *x, *covariance, *counts, *of_group, *mean, *total, *off, *weighed;
    double excess, within2;
    cc_apart apart;
} cc_found;

/* 0 where the data leave a parameter open, else 1. Scratch of CC_SCRATCH doubles, which holds the sums afterwards. */
CC_API int32_t cc_reweighted_fit(const cc_reweighted *asked, double *scratch, cc_found *found);

/* One round of it: write x, its covariance, and what it says of groups. p: scratch of tried family_tried doubles. */
int32_t cc_grouped_fit(const cc_grouped *data, double *scratch, double *p, double *x, double *covariance,
                       cc_apart *apart);

/* Write `weighed`, after a fit of the data that left its sums in scratch. */
void cc_weighed(const cc_grouped *data, double *scratch, const cc_apart *apart, double *weighed);

#endif
