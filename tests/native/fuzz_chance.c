#include "fuzz_chance.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static uint64_t state;

void start(int scene) { state = 88172645463325252ull + (uint64_t)scene * 0x9E3779B97F4A7C15ull; }
uint64_t next(void) { /* xorshift64, Marsaglia 2003 */
    state ^= state << 13, state ^= state >> 7, state ^= state << 17;
    return state;
}
int upto(int n) { return (int)(next() % (uint64_t)(n + 1)); }
double unit(void) { return (double)(next() >> 11) / 9007199254740992.0; }
double around(void) { return 2 * unit() - 1; }
double wild(void) {
    static const double odd[] = {0, 1, -1, 1e-300, 1e300, -1e300, 1e-12, 64, 1e150};
    return upto(9) ? around() * pow(10, upto(3)) : odd[upto(8)];
}
float wild_weight(void) { return (float)fmin(fabs(wild()), FLT_MAX); } /* finite and >= 0: as the core asks */

float gray(int kind) { return kind == 0 ? 0.5f : kind == 1 ? (float)unit() : (float)upto(1); }

void rotation(double R[9]) { /* from a random quaternion */
    double q[4], s = 0;
    for (int k = 0; k < 4; k++) q[k] = around(), s += q[k] * q[k];
    for (int k = 0; k < 4; k++) q[k] /= sqrt(s);
    double w = q[0], x = q[1], y = q[2], z = q[3];
    double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                   2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                   2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
    memcpy(R, r, sizeof r);
}

double *doubles(int n, double scale) {
    double *a = malloc((size_t)n * 8 + 1);
    for (int i = 0; i < n; i++) a[i] = upto(30) ? around() * scale : upto(1) ? wild() : NAN;
    return a;
}
