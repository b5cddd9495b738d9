/* Direction fields of photos: see field.h. Compiled once for each instruction set. */
#include "field.h"
#include "hot.h"
#include "vectors.h"

#define REACH 6           /* px: half-width of the window for the local contrast */
#define CLUTTER 4.0f      /* weight of that window's squared mean gradient in the normalisation */
#define BESIDE 0.3f       /* share kept by a pixel beside the ridge of an edge */
#define NOISE 3.0f        /* standard deviations of the noise at which an edge has certainty 1/2 */
#define QUIET 0.2f        /* least share of the picture that shows only noise */
#define NOISE_OF_QUIET 1.497f /* sigma by that quantile of a Rayleigh distribution: 1 / sqrt(-2 ln(1 - QUIET)) */
#define FULL 1.25f        /* certainty that is written as 255 is 1 / FULL */
#define BINS 1024
#define RING 16            /* rows of the gradient that are kept: 2 REACH + 2 at least */

static inline float larger(float a, float b) { return a > b ? a : b; }

void VARIANT(field_reduce)(const float *in, int64_t stride, int32_t width, int32_t height, int32_t k, float *out) {
    const int32_t w = width / k, h = height / k;
    const float scale = 1.0f / (float)(k * k);
    for (int32_t y = 0; y < h; y++) {
        float *row = out + (size_t)y * (size_t)w;
        for (int32_t x = 0; x < w; x++) row[x] = 0;
        for (int32_t j = 0; j < k; j++) {
            const float *from = in + ((int64_t)y * k + j) * stride;
            if (k == 2)
                for (int32_t x = 0; x < w; x++) row[x] += from[2 * x] + from[2 * x + 1];
            else
                for (int32_t x = 0; x < w; x++)
                    for (int32_t i = 0; i < k; i++) row[x] += from[x * k + i];
        }
        for (int32_t x = 0; x < w; x++) row[x] *= scale;
    }
}

/* Eight places starting at (x, y) in steps of (dx, dy), in a picture of at least two rows and columns. */
static void straighten_eight(const float *in, int32_t width, int32_t height, float x, float y, float dx, float dy,
                             float *restrict out, uint8_t *restrict seen) {
    const f8 lane = __builtin_convertvector(*(const i8 *)LANE, f8), px = x + lane * dx, py = y + lane * dy;
    const i8 inside = (px >= -0.5f) & (py >= -0.5f) & (px <= (float)width - 0.5f) & (py <= (float)height - 0.5f);
    const f8 left = least_of(most_of(px, eight(0)), eight((float)(width - 2)));
    const f8 top = least_of(most_of(py, eight(0)), eight((float)(height - 2)));
    const i8 i = __builtin_convertvector(left, i8), j = __builtin_convertvector(top, i8);
    const f8 u = least_of(most_of(px - __builtin_convertvector(i, f8), eight(0)), eight(1));
    const f8 v = least_of(most_of(py - __builtin_convertvector(j, f8), eight(0)), eight(1));
    f8 a, b, c, d;
    if (signs((i == i[0] + *(const i8 *)LANE) & (j == j[0])) == 255) { /* adjacent, as most are: lenses bend little */
        const float *from = in + (size_t)j[0] * (size_t)width + i[0], *under = from + width;
        a = *(const f8 *)from, b = *(const f8 *)(from + 1), c = *(const f8 *)under, d = *(const f8 *)(under + 1);
    } else {
        pairs(in, j * width + i, &a, &b), pairs(in + width, j * width + i, &c, &d);
    }
    const f8 above = a + u * (b - a), below = c + u * (d - c);
    *(f8 *)out = above + v * (below - above);
    for (int k = 0; k < 8; k++) seen[k] = inside[k] != 0;
}

/* A row of places, starting at (x, y) in steps of (dx, dy). */
static void straighten_run(const float *in, int32_t width, int32_t height, float x, float y, float dx, float dy,
                           int32_t n, float *restrict out, uint8_t *restrict seen) {
    const float right = (float)width - 0.5f, bottom = (float)height - 0.5f;
    const int32_t last_x = width > 1 ? width - 2 : 0, last_y = height > 1 ? height - 2 : 0;
    const int32_t next = width > 1, below = height > 1 ? width : 0;
    for (int32_t k = 0; k < n; k++) {
        const float px = x + (float)k * dx, py = y + (float)k * dy;
        seen[k] = px >= -0.5f && py >= -0.5f && px <= right && py <= bottom;
        const int32_t i = px < (float)last_x ? (int32_t)larger(px, 0) : last_x;
        const int32_t j = py < (float)last_y ? (int32_t)larger(py, 0) : last_y;
        const float u = larger(0, px - (float)i < 1 ? px - (float)i : 1);
        const float v = larger(0, py - (float)j < 1 ? py - (float)j : 1);
        const float *a = in + (size_t)j * (size_t)width + (size_t)i, *b = a + below;
        const float top = a[0] + u * (a[next] - a[0]);
        out[k] = top + v * (b[0] + u * (b[next] - b[0]) - top);
    }
}

void VARIANT(field_straighten)(const float *in, int32_t width, int32_t height, const float *nodes, int32_t step,
                               int32_t wide, int32_t high, float *out, uint8_t *seen) {
    const int32_t across = (wide - 1) / step + 2;
    const float share = 1.0f / (float)step;
    for (int32_t y = 0; y < high; y++) {
        const float *upper_row = nodes + 2 * (size_t)(y / step) * (size_t)across, *lower_row = upper_row + 2 * across;
        const float t = (float)(y % step) * share;
        for (int32_t x = 0; x < wide; x += step) {
            const float *a = upper_row + 2 * (x / step), *b = lower_row + 2 * (x / step);
            const float x0 = a[0] + t * (b[0] - a[0]), y0 = a[1] + t * (b[1] - a[1]);
            const float x1 = a[2] + t * (b[2] - a[2]), y1 = a[3] + t * (b[3] - a[3]);
            const size_t at = (size_t)y * (size_t)wide + (size_t)x;
            const float dx = (x1 - x0) * share, dy = (y1 - y0) * share;
            const int32_t n = imin(step, wide - x), eights = width > 1 && height > 1 ? n / 8 * 8 : 0;
            for (int32_t k = 0; k < eights; k += 8)
                straighten_eight(in, width, height, x0 + (float)k * dx, y0 + (float)k * dy, dx, dy, out + at + k,
                                 seen + at + k);
            straighten_run(in, width, height, x0 + (float)eights * dx, y0 + (float)eights * dy, dx, dy, n - eights,
                           out + at + eights, seen + at + eights);
        }
    }
}

/* gx, gy by Sobel / 8 and m = |g| of the row b between a and c; its ends have none. */
static void gradient_row(const float *a, const float *b, const float *c, int32_t width, float *restrict gx,
                         float *restrict gy, float *restrict m) {
    for (int32_t x = 1; x < width - 1; x++) {
        const float dx = (a[x + 1] - a[x - 1]) + 2 * (b[x + 1] - b[x - 1]) + (c[x + 1] - c[x - 1]);
        const float dy = (c[x - 1] - a[x - 1]) + 2 * (c[x] - a[x]) + (c[x + 1] - a[x + 1]);
        gx[x] = 0.125f * dx, gy[x] = 0.125f * dy, m[x] = 0.125f * sqrtf(dx * dx + dy * dy);
    }
    gx[0] = gy[0] = m[0] = gx[width - 1] = gy[width - 1] = m[width - 1] = 0;
}

/* The last rows of a picture's gradient: few enough to stay in the cache. */
typedef struct {
    const float *in;
    int32_t width, height;
    float *gx, *gy, *m; /* row y of each at (y % RING) width */
} gradients;

static inline size_t kept_at(const gradients *g, int32_t y) { return (size_t)(y % RING) * (size_t)g->width; }

/* Find row y; the first and the last one have no gradient. */
static void find_row(const gradients *g, int32_t y) {
    const size_t w = (size_t)g->width, at = kept_at(g, y);
    const float *row = g->in + (size_t)y * w;
    if (y > 0 && y < g->height - 1) gradient_row(row - w, row, row + w, g->width, g->gx + at, g->gy + at, g->m + at);
    else memset(g->gx + at, 0, 4 * w), memset(g->gy + at, 0, 4 * w), memset(g->m + at, 0, 4 * w);
}

/* The QUIET quantile of all m, by counting in logarithmic bins: the exponent and upper bits of the number. */
static float quiet(const gradients *g) {
    uint32_t count[BINS] = {0};
    size_t all = 0, below = 0;
    for (int32_t y = 0, x = 0; y < g->height; y++, x -= g->width) {
        find_row(g, y);
        const float *m = g->m + kept_at(g, y);
        for (; x < g->width; x += 3) {
            uint32_t bits;
            memcpy(&bits, &m[x], 4);
            count[(bits >> 21) & (BINS - 1)]++, all++;
        }
    }
    for (uint32_t k = 0; k < BINS; k++) {
        if ((float)(below + count[k]) >= QUIET * (float)all) {
            const float share = count[k] ? (QUIET * (float)all - (float)below) / (float)count[k] : 0.0f;
            const uint32_t low = k << 21, high = (k + 1) << 21;
            float a, b;
            memcpy(&a, &low, 4), memcpy(&b, &high, 4);
            return a + share * (b - a);
        }
        below += count[k];
    }
    return 0;
}

/* The mean of m over windows of 2 REACH + 1 px around a row's places, squared; `column` holds the sums of the window's
 * rows, REACH more to both sides: beyond the border there is nothing. */
static void window_mean(const float *restrict column, int32_t width, float *restrict out) {
    const float scale = 1.0f / (float)((2 * REACH + 1) * (2 * REACH + 1));
    for (int32_t x = 0; x < width; x++) {
        float sum = 0;
        for (int32_t k = 0; k <= 2 * REACH; k++) sum += column[x + k];
        out[x] = scale * sum * (scale * sum);
    }
}

static void add_to(float *restrict column, const float *restrict m, int32_t width, float sign) {
    for (int32_t x = 0; x < width; x++) column[x] += sign * m[x];
}

/* The certainty of an edge at each pixel of a row, in [0, 1]: against noise and surroundings, and on its ridge. */
static void certainty(const float *above, const float *m, const float *below, const float *gx, const float *gy,
                      int32_t width, float noise2, float *restrict row) {
    for (int32_t x = 1; x < width - 1; x++) {
        const float ax = fabsf(gx[x]), ay = fabsf(gy[x]), slanted = gx[x] * gy[x];
        const float across = larger(m[x - 1], m[x + 1]), along = larger(above[x], below[x]);
        const float falling = larger(above[x - 1], below[x + 1]), rising = larger(above[x + 1], below[x - 1]);
        const float tilted = slanted > 0 ? falling : rising;
        const float beside = ay < 0.41421356f * ax ? across : ax < 0.41421356f * ay ? along : tilted;
        const float sure = m[x] * m[x] / (m[x] * m[x] + noise2 + CLUTTER * row[x]);
        row[x] = m[x] >= beside ? sure : BESIDE * sure;
    }
    row[0] = row[width - 1] = 0;
}

/* A row's certainties over the sectors, by the fourth power of the cosine of twice the angle to them: sector s is
 * across from s + CC_SECTORS / 2, where the cosine is that of the other sign. gx, gy become the cosine and sine of
 * twice the angle of the gradient, sure becomes what is written where that is 1. */
static void spread(float *restrict gx, float *restrict gy, const float *restrict m, float *restrict sure, int32_t width,
                   size_t n, uint8_t *row) {
    static const float cosine[] = {1, 0.70710678f, 0, -0.70710678f}, sine[] = {0, 0.70710678f, 1, 0.70710678f};
    for (int32_t x = 0; x < width; x++) {
        const float a = gx[x], b = gy[x], scale = 1 / (m[x] * m[x] + 1e-20f);
        gx[x] = (a * a - b * b) * scale, gy[x] = 2 * a * b * scale, sure[x] *= 255.0f * FULL;
    }
    for (int s = 0; s < CC_SECTORS / 2; s++) {
        uint8_t *restrict out = row + (size_t)s * n, *restrict across = row + (size_t)(s + CC_SECTORS / 2) * n;
        const float c = cosine[s], d = sine[s];
        for (int32_t x = 0; x < width; x++) {
            const float turn = gx[x] * c + gy[x] * d, near = turn * turn, value = sure[x] * near * near;
            const int32_t grey = (int32_t)(value < 255.0f ? value : 255.0f);
            out[x] = (uint8_t)(turn > 0 ? grey : 0), across[x] = (uint8_t)(turn > 0 ? 0 : grey);
        }
    }
}

/* The sums of a plane's values and of their squares. */
typedef struct {
    uint64_t sum, squares;
} tally;

static void count_in(const uint8_t *row, int32_t n, tally *t) {
    for (int32_t i = 0; i < n; i += 4096) {
        uint32_t s = 0, s2 = 0;
        for (int32_t k = i; k < imin(i + 4096, n); k++) s += row[k], s2 += (uint32_t)row[k] * row[k];
        t->sum += s, t->squares += s2;
    }
}

static void moments(const tally *t, size_t n, float *mean, float *variance) {
    for (int s = 0; s < CC_SECTORS; s++) {
        const double m = n ? (double)t[s].sum / (double)n : 0;
        mean[s] = (float)m, variance[s] = n ? (float)((double)t[s].squares / (double)n - m * m) : 0;
    }
}

void VARIANT(field_directions)(const float *in, int32_t width, int32_t height, float floor, float *scratch,
                               uint8_t *planes, float *mean, float *variance) {
    const size_t w = (size_t)width, n = w * (size_t)height, ring = RING * w;
    const gradients g = {in, width, height, scratch, scratch + ring, scratch + 2 * ring};
    float *sure = scratch + 3 * ring, *column = sure + w;
    tally totals[CC_SECTORS] = {{0, 0}};
    if (width > 2 && height > 2) {
        const float noise = larger(quiet(&g) * NOISE_OF_QUIET, floor) * NOISE;
        memset(column, 0, (w + 2 * REACH) * sizeof *column);
        for (int32_t y = -REACH; y < height - 1; y++) {
            if (y + REACH < height) {
                find_row(&g, y + REACH);
                add_to(column + REACH, g.m + kept_at(&g, y + REACH), width, 1);
            }
            if (y > REACH) add_to(column + REACH, g.m + kept_at(&g, y - REACH - 1), width, -1);
            if (y < 1) continue;
            const size_t here = kept_at(&g, y);
            const float *m = g.m + here;
            window_mean(column, width, sure);
            certainty(g.m + kept_at(&g, y - 1), m, g.m + kept_at(&g, y + 1), g.gx + here, g.gy + here, width,
                      noise * noise, sure);
            spread(g.gx + here, g.gy + here, m, sure, width, n, planes + (size_t)y * w);
            for (size_t s = 0; s < CC_SECTORS; s++) count_in(planes + s * n + (size_t)y * w, width, totals + s);
        }
    }
    for (size_t s = 0; s < CC_SECTORS; s++) { /* the rows without a gradient */
        const size_t bare = width > 2 && height > 2 ? w : n;
        memset(planes + s * n, 0, bare), memset(planes + (s + 1) * n - bare, 0, bare);
    }
    moments(totals, n, mean, variance);
}

typedef uint16_t two __attribute__((may_alias, aligned(1))); /* adjacent bytes */

void VARIANT(field_halve)(const uint8_t *in, int32_t width, int32_t height, uint8_t *planes, float *mean,
                          float *variance) {
    const int32_t w = width / 2, h = height / 2;
    const size_t n = (size_t)w * (size_t)h;
    tally totals[CC_SECTORS] = {{0, 0}};
    for (size_t s = 0; s < CC_SECTORS; s++) {
        const uint8_t *from = in + s * (size_t)width * (size_t)height;
        for (int32_t y = 0; y < h; y++) {
            const uint8_t *row = from + 2 * (size_t)y * (size_t)width;
            const two *a = (const two *)row, *b = (const two *)(row + width);
            uint8_t *restrict out = planes + s * n + (size_t)y * (size_t)w;
            for (int32_t x = 0; x < w; x++) { /* a line one pixel wide fills two of the four */
                const uint16_t four = (uint16_t)((a[x] & 255) + (a[x] >> 8) + (b[x] & 255) + (b[x] >> 8));
                const uint16_t sum = (uint16_t)(four >> 1);
                out[x] = (uint8_t)(sum < 255 ? sum : 255);
            }
            count_in(out, w, totals + s);
        }
    }
    moments(totals, n, mean, variance);
}
