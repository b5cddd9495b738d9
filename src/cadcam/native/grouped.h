/* Least squares of data that err in groups, for every variance between groups at once: see cadcam/fit/grouped.py.
 *
 * Plain C11 like raster.h; every function writes its answers into memory of the caller.
 */
#ifndef CADCAM_GROUPED_H
#define CADCAM_GROUPED_H

#include <stdint.h>

#include "raster.h"

#define CC_UNKNOWNS 16 /* at most */

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

/* Write x (k) and its covariance (k, k), averaged over what was tried, and how likely (tried, family_tried) each of it
 * is. Scratch of (groups + families) ((k + 1) (k + 4) / 2 + 1) + tried family_tried ((k + 1) (k + 2) / 2 + k) doubles.
 * 0 where the data leave a parameter open, else 1. */
CC_API int32_t cc_grouped_fit(const cc_grouped *data, double *scratch, double *x, double *covariance, double *p);

#endif
