/* Direction fields of photos: see field.h. Compiled once for each instruction set. */
#include "field.h"
#include "hot.h"
#include "vectors.h"

#define REACH 6           /* px: half the window over which a place's own contrast is judged */
#define CLUTTER 6.0f      /* how much the mean gradient of that window, squared, counts against it */
#define BESIDE 0.3f       /* what a pixel beside the top of an edge keeps */
#define NOISE 3.0f        /* standard deviations of a noisy gradient that make an edge as sure as not */
#define QUIET 0.2f        /* the share of the picture that shows noise alone, at least */
#define NOISE_OF_QUIET 1.497f /* sigma by that quantile of a Rayleigh distribution: 1 / sqrt(-2 ln(1 - QUIET)) */
#define FULL 1.25f        /* certainty that is written as 255 is 1 / FULL */
#define BINS 1024

static inline float larger(float a, float b) { return a > b ? a : b; }

void VARIANT(field_reduce)(const float *in, int32_t width, int32_t height, int32_t k, float *out) {
    const int32_t w = width / k, h = height / k;
    const float scale = 1.0f / (float)(k * k);
    for (int32_t y = 0; y < h; y++) {
        float *row = out + (size_t)y * (size_t)w;
        for (int32_t x = 0; x < w; x++) row[x] = 0;
        for (int32_t j = 0; j < k; j++) {
            const float *from = in + ((size_t)y * (size_t)k + (size_t)j) * (size_t)width;
            if (k == 2)
                for (int32_t x = 0; x < w; x++) row[x] += from[2 * x] + from[2 * x + 1];
            else
                for (int32_t x = 0; x < w; x++)
                    for (int32_t i = 0; i < k; i++) row[x] += from[x * k + i];
        }
        for (int32_t x = 0; x < w; x++) row[x] *= scale;
    }
}

/* Eight places from (x, y) on by (dx, dy), in a picture of two rows and columns at least. */
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
    pairs(in, j * width + i, &a, &b), pairs(in + width, j * width + i, &c, &d);
    const f8 above = a + u * (b - a), below = c + u * (d - c);
    *(f8 *)out = choose(inside, above + v * (below - above), eight(0));
    for (int k = 0; k < 8; k++) seen[k] = inside[k] != 0;
}

/* A row of places, from (x, y) on by (dx, dy). */
static void straighten_run(const float *in, int32_t width, int32_t height, float x, float y, float dx, float dy, int32_t n,
                           float *restrict out, uint8_t *restrict seen) {
    const float right = (float)width - 0.5f, bottom = (float)height - 0.5f;
    const int32_t last_x = width > 1 ? width - 2 : 0, last_y = height > 1 ? height - 2 : 0;
    const int32_t next = width > 1, below = height > 1 ? width : 0;
    for (int32_t k = 0; k < n; k++) {
        const float px = x + (float)k * dx, py = y + (float)k * dy;
        seen[k] = px >= -0.5f && py >= -0.5f && px <= right && py <= bottom;
        if (!seen[k]) continue;
        const int32_t i = imin((int32_t)larger(px, 0), last_x), j = imin((int32_t)larger(py, 0), last_y);
        const float u = larger(0, px - (float)i < 1 ? px - (float)i : 1), v = larger(0, py - (float)j < 1 ? py - (float)j : 1);
        const float *a = in + (size_t)j * (size_t)width + (size_t)i, *b = a + below;
        const float top = a[0] + u * (a[next] - a[0]);
        out[k] = top + v * (b[0] + u * (b[next] - b[0]) - top);
    }
}

void VARIANT(field_straighten)(const float *in, int32_t width, int32_t height, const float *nodes, int32_t step,
                               int32_t wide, int32_t high, float *out, uint8_t *seen) {
    const int32_t across = (wide - 1) / step + 2;
    const float share = 1.0f / (float)step;
    memset(out, 0, (size_t)wide * (size_t)high * sizeof *out);
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
                straighten_eight(in, width, height, x0 + (float)k * dx, y0 + (float)k * dy, dx, dy, out + at + k, seen + at + k);
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

static void gradient(const float *in, int32_t width, int32_t height, float *gx, float *gy, float *m) {
    const size_t w = (size_t)width, last = ((size_t)height - 1) * w;
    for (size_t y = w; y < last; y += w) gradient_row(in + y - w, in + y, in + y + w, width, gx + y, gy + y, m + y);
    for (size_t x = 0; x < w; x++) gx[x] = gy[x] = m[x] = gx[last + x] = gy[last + x] = m[last + x] = 0;
}

/* What QUIET of all m lie below, by counting in bins of its logarithm: the exponent and the upper bits of the number. */
static float quiet(const float *m, size_t n) {
    uint32_t count[BINS] = {0};
    size_t all = 0, below = 0;
    for (size_t i = 0; i < n; i += 3) {
        uint32_t bits;
        memcpy(&bits, &m[i], 4);
        count[(bits >> 21) & (BINS - 1)]++, all++;
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

/* The mean of m over windows of 2 REACH + 1 px, squared; beyond the border there is none. */
static void window_mean(const float *m, int32_t width, int32_t height, float *column, float *out) {
    const size_t w = (size_t)width;
    const float scale = 1.0f / (float)((2 * REACH + 1) * (2 * REACH + 1));
    for (int32_t x = 0; x < width; x++) column[x] = 0;
    for (int32_t y = 0; y < imin(REACH, height); y++)
        for (int32_t x = 0; x < width; x++) column[x] += m[(size_t)y * w + (size_t)x];
    for (int32_t y = 0; y < height; y++) {
        if (y + REACH < height)
            for (int32_t x = 0; x < width; x++) column[x] += m[((size_t)y + REACH) * w + (size_t)x];
        if (y > REACH)
            for (int32_t x = 0; x < width; x++) column[x] -= m[((size_t)y - REACH - 1) * w + (size_t)x];
        double sum = 0;
        for (int32_t x = 0; x < imin(REACH, width); x++) sum += column[x];
        for (int32_t x = 0; x < width; x++) {
            if (x + REACH < width) sum += column[x + REACH];
            if (x > REACH) sum -= column[x - REACH - 1];
            const float mean = scale * (float)sum;
            out[(size_t)y * w + (size_t)x] = mean * mean;
        }
    }
}

/* How sure an edge is at each pixel of a row, in [0, 1]: against noise and its surroundings, and on top of its ridge. */
static void certainty(const float *m, const float *gx, const float *gy, int32_t width, float noise2, float *restrict row) {
    const float *above = m - width, *below = m + width;
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

/* A row's certainties over the sectors, by the fourth power of the cosine of twice the angle to them: sector s is across
 * from s + CC_SECTORS / 2, where the cosine is that of the other sign. */
static void spread(const float *gx, const float *gy, const float *m, const float *sure, int32_t width, size_t n, uint8_t *row) {
    static const float cosine[] = {1, 0.70710678f, 0, -0.70710678f}, sine[] = {0, 0.70710678f, 1, 0.70710678f};
    for (int s = 0; s < CC_SECTORS / 2; s++) {
        uint8_t *restrict out = row + (size_t)s * n, *restrict across = row + (size_t)(s + CC_SECTORS / 2) * n;
        const float c = cosine[s], d = sine[s];
        for (int32_t x = 0; x < width; x++) {
            const float a = gx[x], b = gy[x];
            const float turn = ((a * a - b * b) * c + 2 * a * b * d) / (m[x] * m[x] + 1e-20f), near = turn * turn;
            const float value = 255.0f * FULL * sure[x] * near * near;
            const int32_t grey = (int32_t)(value < 255.0f ? value : 255.0f);
            out[x] = (uint8_t)(turn > 0 ? grey : 0), across[x] = (uint8_t)(turn > 0 ? 0 : grey);
        }
    }
}

static void moments(const uint8_t *plane, size_t n, float *mean, float *variance) {
    uint64_t sum = 0, squares = 0;
    for (size_t i = 0; i < n; i += 4096) {
        uint32_t s = 0, s2 = 0;
        const size_t end = i + 4096 < n ? i + 4096 : n;
        for (size_t k = i; k < end; k++) s += plane[k], s2 += (uint32_t)plane[k] * plane[k];
        sum += s, squares += s2;
    }
    const double m = n ? (double)sum / (double)n : 0;
    *mean = (float)m, *variance = n ? (float)((double)squares / (double)n - m * m) : 0;
}

void VARIANT(field_directions)(const float *in, int32_t width, int32_t height, float floor, float *scratch,
                               uint8_t *planes, float *mean, float *variance) {
    const size_t w = (size_t)width, n = w * (size_t)height;
    float *gx = scratch, *gy = gx + n, *m = gy + n, *sure = m + n;
    memset(planes, 0, n * CC_SECTORS);
    if (width > 2 && height > 2) {
        gradient(in, width, height, gx, gy, m);
        const float noise = larger(quiet(m, n) * NOISE_OF_QUIET, floor) * NOISE;
        float *column = sure; /* its first row is written last */
        window_mean(m, width, height, column, sure);
        for (int32_t y = 1; y < height - 1; y++) {
            const size_t at = (size_t)y * w;
            certainty(m + at, gx + at, gy + at, width, noise * noise, sure + at);
            spread(gx + at, gy + at, m + at, sure + at, width, n, planes + at);
        }
    }
    for (int s = 0; s < CC_SECTORS; s++) moments(planes + (size_t)s * n, n, mean + s, variance + s);
}

void VARIANT(field_halve)(const uint8_t *in, int32_t width, int32_t height, uint8_t *planes, float *mean,
                          float *variance) {
    const int32_t w = width / 2, h = height / 2;
    const size_t n = (size_t)w * (size_t)h;
    for (int s = 0; s < CC_SECTORS; s++) {
        const uint8_t *from = in + (size_t)s * (size_t)width * (size_t)height;
        for (int32_t y = 0; y < h; y++) {
            const uint8_t *a = from + 2 * (size_t)y * (size_t)width, *b = a + width;
            uint8_t *restrict out = planes + (size_t)s * n + (size_t)y * (size_t)w;
            for (int32_t x = 0; x < w; x++) { /* a line one pixel wide fills two of the four */
                const int32_t sum = (a[2 * x] + a[2 * x + 1] + b[2 * x] + b[2 * x + 1]) / 2;
                out[x] = (uint8_t)(sum < 255 ? sum : 255);
            }
        }
        moments(planes + (size_t)s * n, n, mean + s, variance + s);
    }
}
