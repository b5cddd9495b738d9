/* From the face and 1/z of each sample to the outputs: shading is deferred, so hidden samples cost none. */
#include "hot.h"

/* What the shading of one output needs, in float: the direction of plane points and the light, in the world. */
typedef struct { float d[9], fill[3], back[3], ambient, head; } light; /* fill, back: times their strength */

/* Eight samples of a row: what was met there, and from where. */
typedef struct {
    _Alignas(32) int32_t id[TILE];
    _Alignas(32) float d[3][TILE]; /* directions in the world, not of unit length */
    _Alignas(32) float n[3][TILE]; /* normals, as in the scene */
    _Alignas(32) float color[3][TILE]; /* of the parts; the background's where nothing was met */
    _Alignas(32) float along[TILE]; /* n . d: positive where the back is seen */
} eight;

static inline const float *normal_of(const cc_frame *f, int32_t id) { return f->scene->normal[id < 0 ? 0 : id]; }
static inline const float *color_of(const cc_frame *f, int32_t id) {
    return id < 0 ? f->view->background : f->scene->color[f->scene->paint[id]];
}

static inline void look_up(const cc_frame *f, const light *l, int32_t tx, int32_t y, const int32_t *id, eight *e) {
    const cc_lens *lens = f->view->lens;
    const size_t at = ((size_t)(y / TILE) * (size_t)f->tiles_x + (size_t)tx) * TILE_AREA + (size_t)(y % TILE) * TILE;
    float px[TILE], py[TILE];
    for (int i = 0; i < TILE; i++) {
        px[i] = lens ? (float)lens->x[at + (size_t)i] : (float)(tx * TILE + i);
        py[i] = lens ? (float)lens->y[at + (size_t)i] : (float)y;
    }
    int same = 1;
    for (int i = 0; i < TILE; i++) same &= id[i] == id[0], e->id[i] = id[i];
    if (same) { /* the common case, and a fast one */
        const float *n = normal_of(f, id[0]), *color = color_of(f, id[0]);
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < TILE; i++) e->n[k][i] = n[k], e->color[k][i] = color[k];
    } else
        for (int i = 0; i < TILE; i++) {
            const float *n = normal_of(f, id[i]), *color = color_of(f, id[i]);
            for (int k = 0; k < 3; k++) e->n[k][i] = n[k], e->color[k][i] = color[k];
        }
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < TILE; i++) e->d[k][i] = l->d[3 * k] * px[i] + (l->d[3 * k + 1] * py[i] + l->d[3 * k + 2]);
    for (int i = 0; i < TILE; i++)
        e->along[i] = e->n[0][i] * e->d[0][i] + e->n[1][i] * e->d[1][i] + e->n[2][i] * e->d[2][i];
}

/* Matt, two-sided: ambient, a light at the camera, two distant ones. */
static inline void shade(const light *l, const eight *e, float rgb[TILE][3]) {
    float value[TILE];
    for (int i = 0; i < TILE; i++) {
        float length = sqrtf(e->d[0][i] * e->d[0][i] + e->d[1][i] * e->d[1][i] + e->d[2][i] * e->d[2][i]);
        float fill = e->n[0][i] * l->fill[0] + e->n[1][i] * l->fill[1] + e->n[2][i] * l->fill[2];
        float back = e->n[0][i] * l->back[0] + e->n[1][i] * l->back[1] + e->n[2][i] * l->back[2];
        fill = e->along[i] > 0 ? -fill : fill; /* the side that faces the camera */
        back = e->along[i] > 0 ? -back : back;
        value[i] = l->ambient + l->head * (fabsf(e->along[i]) / length) + (fill > 0 ? fill : 0) + (back > 0 ? back : 0);
    }
    for (int i = 0; i < TILE; i++) value[i] = e->id[i] < 0 ? 1.0f : value[i];
    for (int i = 0; i < TILE; i++)
        for (int k = 0; k < 3; k++) {
            float c = e->color[k][i] * value[i];
            rgb[i][k] = c < 1 ? c : 1;
        }
}

/* Unit normals in the camera frame, turned towards the camera. */
static void face_camera(const cc_frame *f, const eight *e, float out[TILE][3]) {
    const double *R = f->view->rotation;
    for (int i = 0; i < TILE; i++)
        for (int k = 0; k < 3; k++) {
            double c = R[3 * k] * e->n[0][i] + R[3 * k + 1] * e->n[1][i] + R[3 * k + 2] * e->n[2][i];
            out[i][k] = e->id[i] < 0 ? 0.0f : (float)(e->along[i] > 0 ? -c : c);
        }
}

/* Copy the first n of eight items; a constant size is a few instructions, a variable one a call. */
static inline void put(void *to, const void *from, size_t n, size_t size) {
    if (n == TILE) memcpy(to, from, TILE * size);
    else memcpy(to, from, n * size);
}

static void write_eight(const cc_frame *f, const light *l, int32_t tx, int32_t y, const float *w, const int32_t *id) {
    const cc_view *v = f->view;
    const size_t n = (size_t)imin(TILE, f->width - tx * TILE), at = (size_t)y * (size_t)f->width + (size_t)tx * TILE;
    float number[TILE], triple[TILE][3];
    int32_t part[TILE];
    eight e;
    if (v->depth) {
        for (int i = 0; i < TILE; i++) {
            float z = 1.0f / w[i];
            number[i] = id[i] < 0 ? INFINITY : z;
        }
        put(v->depth + at, number, n, sizeof *number);
    }
    if (v->face) put(v->face + at, id, n, sizeof *id);
    if (v->part) {
        for (int i = 0; i < TILE; i++) part[i] = id[i] < 0 ? -1 : f->scene->part[id[i]];
        put(v->part + at, part, n, sizeof *part);
    }
    if (v->coverage) {
        for (int i = 0; i < TILE; i++) number[i] = (float)(id[i] >= 0);
        put(v->coverage + at, number, n, sizeof *number);
    }
    if (!v->image && !v->normal) return;
    look_up(f, l, tx, y, id, &e);
    if (v->image) {
        shade(l, &e, triple);
        put(v->image + 3 * at, triple, n, sizeof *triple);
    }
    if (v->normal) {
        face_camera(f, &e, triple);
        put(v->normal + 3 * at, triple, n, sizeof *triple);
    }
}

/* Add a row of samples to the sums (r, g, b, covered) of an output row. */
static void add_row(const cc_frame *f, const light *l, int32_t y, const int32_t *ids, float *sums) {
    float rgb[TILE][3];
    eight e;
    for (int32_t tx = 0; tx < f->tiles_x; tx++) {
        look_up(f, l, tx, y, ids + (size_t)tx * TILE_AREA, &e);
        shade(l, &e, rgb);
        for (int i = 0; i < imin(TILE, f->width - tx * TILE); i++) {
            float *sum = sums + 4 * (size_t)((tx * TILE + i) / f->view->samples);
            for (int k = 0; k < 3; k++) sum[k] += rgb[i][k];
            sum[3] += e.id[i] < 0 ? 0.0f : 1.0f;
        }
    }
}

static light light_of(const cc_view *v) {
    light l = {.ambient = v->ambient, .head = v->head};
    for (int k = 0; k < 9; k++) l.d[k] = (float)v->ray[k];
    for (int k = 0; k < 3; k++) l.fill[k] = v->fill * (float)v->fill_from[k], l.back[k] = v->back * (float)v->back_from[k];
    return l;
}

void VARIANT(write_band)(const band *b) {
    const cc_frame *f = b->frame;
    const cc_view *v = f->view;
    light l = light_of(v);
    float *sums = b->worker->row;
    int n = v->samples;
    for (int32_t y = b->y0; y <= b->y1; y++) {
        size_t at = (size_t)(y / TILE - b->first_tiles) * (size_t)f->tiles_x * TILE_AREA + (size_t)(y % TILE) * TILE;
        const float *w = b->worker->inverse_z + at;
        const int32_t *id = b->worker->id + at;
        if (n == 1) {
            for (int32_t tx = 0; tx < f->tiles_x; tx++)
                write_eight(f, &l, tx, y, w + (size_t)tx * TILE_AREA, id + (size_t)tx * TILE_AREA);
            continue;
        }
        if (y % n == 0) memset(sums, 0, (size_t)v->width * 4 * sizeof *sums);
        add_row(f, &l, y, id, sums);
        if (y % n < n - 1) continue;
        size_t row = (size_t)(y / n) * (size_t)v->width;
        float scale = 1.0f / (float)(n * n);
        for (int32_t x = 0; x < v->width; x++) {
            if (v->image)
                for (int k = 0; k < 3; k++) v->image[3 * (row + (size_t)x) + k] = sums[4 * (size_t)x + k] * scale;
            if (v->coverage) v->coverage[row + (size_t)x] = sums[4 * (size_t)x + 3] * scale;
        }
    }
}
