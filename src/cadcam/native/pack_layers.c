/* Layers of a view as pictures of files: see pack.h. */
#include "pack.h"
#include "rows.h"

#include <math.h>
#include <string.h>

typedef struct {
    const float *depth, *normal;
    int64_t width;
    float step;
} layers;

/* The first pixel from i on where there is something, else n. Two at a time: most of a picture is often empty. */
static int64_t filled(const float *depth, int64_t i, int64_t n) {
    const float nothing[2] = {INFINITY, INFINITY};
    for (uint64_t two, none; i + 2 <= n; i += 2) {
        memcpy(&two, depth + i, 8), memcpy(&none, nothing, 8);
        if (two != none) break;
    }
    while (i < n && !(depth[i] < INFINITY)) i++;
    return i;
}

/* The first pixel from i on where there is nothing; n if there is none. */
static int64_t empty(const float *depth, int64_t i, int64_t n) {
    while (i < n && depth[i] < INFINITY) i++;
    return i;
}

static float held(float v, float most) {
    v = v > 0 ? v : 0;
    return v < most ? v : most;
}

static int depth_row(const void *picture, int64_t y, uint8_t *row) {
    const layers *l = picture;
    const int64_t n = l->width;
    const float *const depth = l->depth + y * n;
    int64_t i = filled(depth, 0, n);
    const int any = i < n;
    memset(row, 0, 2 * (size_t)n);
    for (int64_t to; i < n; i = filled(depth, to, n)) {
        to = empty(depth, i, n);
        for (int64_t k = i; k < to; k++) {
            const int32_t steps = (int32_t)held(depth[k] / l->step + 0.5f, 65535);
            row[2 * k] = (uint8_t)(steps >> 8), row[2 * k + 1] = (uint8_t)steps;
        }
    }
    return any;
}

static int normal_row(const void *picture, int64_t y, uint8_t *row) {
    const layers *l = picture;
    const int64_t n = l->width;
    const float *const depth = l->depth + y * n, *const normal = l->normal + 3 * y * n;
    int64_t i = filled(depth, 0, n);
    const int any = i < n;
    memset(row, 0, 3 * (size_t)n);
    for (int64_t to; i < n; i = filled(depth, to, n)) {
        to = empty(depth, i, n);
        for (int64_t k = 3 * i; k < 3 * to; k++) row[k] = (uint8_t)(int32_t)held(normal[k] * 127.5f + 128, 255);
    }
    return any;
}

int64_t cc_pack_depth(const float *depth, int32_t width, int32_t height, float step, uint8_t *out, int64_t room) {
    const layers picture = {.depth = depth, .width = width, .step = step};
    return pack_rows(depth_row, &picture, 2 * (int64_t)width, height, 2, out, room);
}

int64_t cc_pack_normals(const float *depth, const float *normal, int32_t width, int32_t height, uint8_t *out,
                        int64_t room) {
    const layers picture = {.depth = depth, .normal = normal, .width = width};
    return pack_rows(normal_row, &picture, 3 * (int64_t)width, height, 3, out, room);
}
