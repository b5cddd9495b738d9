/* Random and vicious tasks of correlate.h, for a build with sanitizers: fuzz_correlate NUMBER.
 *
 * Planes down to one pixel, taps that reach beyond them, masks shared or not and empty, templates of few points with
 * useless slopes, starts anywhere. Beyond what the sanitizers see: rows searched one by one give what all at once give,
 * correlations are at most 1, and every number that comes out is finite. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "correlate.h"
#include "fuzz_chance.h"

static void fail(const char *what, int i) {
    fprintf(stderr, "task %d: %s\n", i, what);
    exit(1);
}

static float *filled(size_t n, int kind) { /* exactly as large as it must be */
    float *p = malloc(n * sizeof *p + !n);
    for (size_t i = 0; i < n; i++) p[i] = kind == 0 ? 0.5f : kind == 1 ? (float)unit() : (float)(i & 1);
    return p;
}

/* Zero mean and unit length over what counts, as the caller promises. */
static void normalise(float *w, const float *inside, int taps) {
    double sum = 0, n = 0, square = 0;
    for (int t = 0; t < taps; t++) sum += inside[t] * w[t], n += inside[t];
    for (int t = 0; t < taps; t++) w[t] = n > 0 ? inside[t] * (float)(w[t] - sum / n) : 0, square += w[t] * w[t];
    for (int t = 0; t < taps; t++) w[t] = square > 1e-6 ? (float)(w[t] / sqrt(square)) : 0;
}

static void search(int i, const cc_plane *plane) {
    const int taps = upto(40), count = 1 + upto(9), masks = upto(1) ? count : 1, reach = upto(7);
    const size_t pixels = (size_t)plane->width * (size_t)plane->height;
    int32_t *dx = malloc(sizeof *dx * (size_t)(taps + 1)), *dy = malloc(sizeof *dy * (size_t)(taps + 1));
    for (int t = 0; t < taps; t++) dx[t] = upto(2 * reach) - reach, dy[t] = upto(2 * reach) - reach;
    float *weight = filled((size_t)(taps * count), 1), *inside = filled((size_t)(taps * masks), upto(2));
    for (int t = 0; t < taps * masks; t++) inside[t] = inside[t] > 0.3f;
    for (int k = 0; k < count; k++) normalise(weight + k * taps, inside + (masks == 1 ? 0 : k * taps), taps);
    cc_search s = {*plane, dx, dy, weight, inside, taps, count, masks, upto(1), upto(1) ? 0 : 1e-4f, NULL, NULL};
    float *best[2];
    int32_t *which[2];
    for (int k = 0; k < 2; k++) {
        best[k] = malloc(pixels * sizeof(float)), which[k] = malloc(pixels * sizeof(int32_t));
        s.best = best[k], s.which = which[k];
        if (k == 0 && cc_search_rows(&s, 0, plane->height)) fail("out of memory", i);
        for (int y = 0; k == 1 && y < plane->height; y++)
            if (cc_search_rows(&s, y, y + 1)) fail("out of memory", i);
    }
    if (memcmp(best[0], best[1], pixels * 4) || memcmp(which[0], which[1], pixels * 4)) fail("rows differ", i);
    for (size_t k = 0; k < pixels; k++) {
        if (!(fabsf(best[0][k]) <= 1.01f) && s.least_variance > 0) fail("a correlation above 1", i);
        if (which[0][k] < -1 || which[0][k] >= count) fail("an orientation that is not there", i);
    }
    for (int k = 0; k < 2; k++) free(best[k]), free(which[k]);
    free(dx), free(dy), free(weight), free(inside);
}

static void climb(int i, const cc_plane *plane) {
    if (plane->width < 2 || plane->height < 2) return;
    const int n = 1 + upto(40), motions = 3 + upto(1), count = upto(5), size = (n + 7) / 8 * 8;
    float *u = filled((size_t)size, 1), *v = filled((size_t)size, 1), *value = filled((size_t)size, 1);
    float *slope = filled((size_t)(size * motions), 1);
    for (int k = 0; k < size; k++) {
        u[k] = k < n ? 20 * (float)around() : 0, v[k] = k < n ? 20 * (float)around() : 0;
        value[k] = k < n ? (float)around() / sqrtf((float)n) : 0;
        for (int m = 0; m < motions; m++) slope[m * size + k] = k < n ? (float)around() : 0;
    }
    double inverse[16], pose[20], start[20], score[5] = {0}, moment[80] = {0}, shown[80] = {0};
    for (int k = 0; k < 16; k++) inverse[k] = upto(4) ? around() : 1e12 * around();
    for (int k = 0; k < count; k++) {
        pose[4 * k] = upto(5) ? plane->width * unit() : 1e6 * around();
        pose[4 * k + 1] = plane->height * around();
        pose[4 * k + 2] = 7 * around(), pose[4 * k + 3] = 0.2 + unit();
    }
    memcpy(start, pose, sizeof start);
    cc_register r = {*plane, u, v, value, slope, inverse, n, motions, upto(1), upto(20), 1e-3, 1 + 50 * unit(), 30};
    if (cc_register_poses(&r, pose, score, count)) fail("out of memory", i);
    for (int k = 0; k < count; k++)
        if (!isfinite(score[k])) fail("a score that is no number", i);
    r.cubic = 1;
    if (cc_register_pulls(&r, 1 << upto(3), start, moment, shown, count)) fail("out of memory", i);
    for (int k = 0; k < count * motions * motions; k++)
        if (!isfinite(moment[k]) || !isfinite(shown[k])) fail("a pull that is no number", i);
    free(u), free(v), free(value), free(slope);
}

static int ascending(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Spots: eight pixels at a time or one, the response is the second of its eight steps; the outline stays as it was. */
static void spots(int i, const cc_plane *plane) {
    const int w = plane->width, h = plane->height;
    cc_spots s = {.plane = *plane, .reach = upto(6), .dark = upto(1), .level = 1e-3f + (float)unit()};
    for (int d = 0; d < 8; d++) {
        s.dx_in[d] = upto(2 * s.reach) - s.reach, s.dy_in[d] = upto(2 * s.reach) - s.reach;
        s.dx_out[d] = upto(2 * s.reach) - s.reach, s.dy_out[d] = upto(2 * s.reach) - s.reach;
    }
    s.response = malloc((size_t)(w * h) * sizeof(float));
    for (int k = 0; k < w * h; k++) s.response[k] = -7;
    cc_find_spots(&s);
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            const float *here = plane->pixels + y * w + x, response = s.response[y * w + x];
            const int inner = x >= s.reach && x < w - s.reach && y >= s.reach && y < h - s.reach;
            float step[8];
            for (int d = 0; inner && d < 8; d++) {
                const float in = here[s.dy_in[d] * w + s.dx_in[d]], out = here[s.dy_out[d] * w + s.dx_out[d]];
                step[d] = (s.dark ? out - in : in - out) / fmaxf(out + in, s.level);
            }
            if (inner) qsort(step, 8, sizeof *step, ascending);
            if (response != (inner ? step[1] : -7)) fail("a spot that is none", i);
        }
    free(s.response);
}

int main(int argc, char **argv) {
    const int tasks = argc > 1 ? atoi(argv[1]) : 100;
    start(0);
    for (int i = 0; i < tasks; i++) {
        const int w = 1 + upto(upto(1) ? 70 : 4), h = 1 + upto(upto(1) ? 40 : 4), factor = 1 + upto(6);
        float *pixels = filled((size_t)(w * h), upto(2));
        const cc_plane plane = {pixels, w, h};
        float *small = malloc(sizeof(float) * (size_t)((w + factor - 1) / factor * ((h + factor - 1) / factor)));
        cc_shrink(&plane, factor, small);
        search(i, &plane), climb(i, &plane), spots(i, &plane);
        free(pixels), free(small);
    }
    printf("%d scenes\n", tasks);
    return 0;
}
