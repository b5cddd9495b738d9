/* Scenes (clusters of neighbouring triangles), workers, frames, and the choice of instruction set. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"
#if CC_HAS_V3
#include <cpuid.h>
#endif

void *aligned_block(size_t bytes) {
    /* over-allocate and keep malloc's pointer in front: aligned_alloc is missing on Windows */
    if (bytes > SIZE_MAX - 128) return NULL;
    char *raw = malloc(bytes + 128);
    if (!raw) return NULL;
    char *block = (char *)(((uintptr_t)raw + 127) & ~(uintptr_t)63);
    memcpy(block - sizeof(char *), &raw, sizeof raw);
    return block;
}

void aligned_release(void *block) {
    char *raw;
    if (!block) return;
    memcpy(&raw, (char *)block - sizeof(char *), sizeof raw);
    free(raw);
}

/* ---- clusters: triangles sorted by size class, then along a space-filling curve, cut every CLUSTER */

typedef struct { uint64_t key; uint32_t face; } keyed;

static uint64_t spread(uint64_t v) { /* bits of a 20-bit number to every third place */
    v = (v | v << 32) & 0x1F00000000FFFFull;
    v = (v | v << 16) & 0x1F0000FF0000FFull;
    v = (v | v << 8) & 0x100F00F00F00F00Full;
    v = (v | v << 4) & 0x10C30C30C30C30C3ull;
    return (v | v << 2) & 0x1249249249249249ull;
}

static double largest3(double a, double b, double c) {
    double m = a > b ? a : b;
    return m > c ? m : c;
}

/* Large triangles go to clusters of their own, or they would blow up the boxes of small ones. */
static uint64_t size_class(double extent, double whole) {
    uint64_t k = 0;
    for (double limit = whole / 8; k < 7 && extent < limit; limit /= 4) k++;
    return k;
}

static uint64_t key_of(const double *v, const int32_t *f, const double low[3], double whole) {
    const double *a = v + 3 * (size_t)f[0], *b = v + 3 * (size_t)f[1], *c = v + 3 * (size_t)f[2];
    uint64_t key = 0;
    double extent = 0;
    for (int k = 0; k < 3; k++) {
        double least = -largest3(-a[k], -b[k], -c[k]), most = largest3(a[k], b[k], c[k]);
        double t = whole > 0 ? ((least * 0.5 + most * 0.5) - low[k]) / whole : 0;
        if (most - least > extent) extent = most - least;
        key |= spread(t > 0 ? (uint64_t)((t < 1 ? t : 1) * 1048575.0) : 0) << k;
    }
    return key | size_class(extent, whole) << 60;
}

static void radix_sort(keyed *a, keyed *b, size_t n) { /* by key, stable; the result is in a */
    for (int shift = 0; shift < 64; shift += 16) {
        static const size_t buckets = 65536;
        size_t *at = calloc(buckets + 1, sizeof *at);
        if (!at) return; /* unsorted clusters are slower, but correct */
        for (size_t i = 0; i < n; i++) at[((a[i].key >> shift) & 0xFFFF) + 1]++;
        for (size_t i = 0; i < buckets; i++) at[i + 1] += at[i];
        for (size_t i = 0; i < n; i++) b[at[(a[i].key >> shift) & 0xFFFF]++] = a[i];
        free(at);
        memcpy(a, b, n * sizeof *a);
    }
}

static keyed *sorted_faces(const double *v, const int32_t *faces, size_t n) {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (size_t i = 0; i < 3 * n; i++)
        for (int k = 0; k < 3; k++) {
            double t = v[3 * (size_t)faces[i] + k];
            if (t < low[k]) low[k] = t;
            if (t > high[k]) high[k] = t;
        }
    double whole = largest3(high[0] - low[0], high[1] - low[1], high[2] - low[2]);
    keyed *a = malloc((n + 1) * sizeof *a), *b = malloc((n + 1) * sizeof *b);
    if (a && b) {
        for (size_t i = 0; i < n; i++) a[i] = (keyed){key_of(v, faces + 3 * i, low, whole), (uint32_t)i};
        radix_sort(a, b, n);
    } else {
        free(a);
        a = NULL;
    }
    free(b);
    return a;
}

/* Append one cluster of n sorted triangles; vertices that they share are stored once. */
static void add_cluster(cc_scene *s, const double *v, const int32_t *faces, const keyed *sorted, size_t n,
                        size_t *n_vertices) {
    face_block *of = &s->faces[s->n_clusters];
    cluster *c = &s->clusters[s->n_clusters++];
    size_t used = 0;
    *c = (cluster){
        {INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}, (uint32_t)*n_vertices, 0, (uint16_t)n};
    memset(of, 0, sizeof *of);
    int32_t seen[CORNERS];
    for (size_t i = 0; i < n; i++) {
        const int32_t *f = faces + 3 * (size_t)sorted[i].face;
        of->id[i] = (int32_t)sorted[i].face;
        for (int k = 0; k < 3; k++) {
            size_t j = 0;
            while (j < used && seen[j] != f[k]) j++;
            if (j == used) seen[used++] = f[k];
            of->corner[k][i] = (uint8_t)j;
        }
    }
    for (; used % 8; used++) seen[used] = seen[used - 1];
    double *at = s->vertices + 3 * *n_vertices;
    for (int k = 0; k < 3; k++)
        for (size_t j = 0; j < used; j++) {
            const double p = *at++ = v[3 * (size_t)seen[j] + (size_t)k];
            if (p < c->low[k]) c->low[k] = p;
            if (p > c->high[k]) c->high[k] = p;
        }
    c->n_vertices = (uint16_t)used;
    *n_vertices += used;
}

/* Unit normal of a triangle, 0 without area; returns whether rounding leaves it its direction. */
static int unit_normal(const double *v, const int32_t *f, double n[3]) {
    const double *a = v + 3 * (size_t)f[0], *b = v + 3 * (size_t)f[1], *c = v + 3 * (size_t)f[2];
    double p[3], q[3], pp = 0, qq = 0, nn = 0;
    for (int k = 0; k < 3; k++) p[k] = b[k] - a[k], q[k] = c[k] - a[k], pp += p[k] * p[k], qq += q[k] * q[k];
    for (int k = 0; k < 3; k++) {
        n[k] = p[(k + 1) % 3] * q[(k + 2) % 3] - p[(k + 2) % 3] * q[(k + 1) % 3];
        nn += n[k] * n[k];
    }
    const double length = sqrt(nn);
    for (int k = 0; k < 3; k++) n[k] = length > 0 ? n[k] / length : 0;
    return length > 0x1p-24 * sqrt(pp * qq);
}

static void set_planes(cc_scene *s, const double *v, const int32_t *faces, int64_t i) {
    const cluster *c = &s->clusters[i];
    const double sides = (c->high[0] - c->low[0]) + (c->high[1] - c->low[1]) + (c->high[2] - c->low[2]);
    face_block *of = &s->faces[i];
    for (int k = 0; k < c->n_faces; k++) {
        const int32_t *f = faces + 3 * (size_t)of->id[k];
        const double *p = v + 3 * (size_t)f[0];
        double n[3];
        if (!unit_normal(v, f, n)) continue;
        const double above = n[0] * (c->low[0] - p[0]) + n[1] * (c->low[1] - p[1]) + n[2] * (c->low[2] - p[2]);
        of->x[k] = (int8_t)lrint(127 * n[0]), of->y[k] = (int8_t)lrint(127 * n[1]);
        of->z[k] = (int8_t)lrint(127 * n[2]);
        of->offset[k] = (int8_t)lrint(127 * above / sides);
    }
}

CC_API cc_scene *cc_scene_new(const double *vertices, const int32_t *faces, int64_t n_faces, const int32_t *part,
                              const int32_t *paint, const float *colors, int64_t n_colors) {
    size_t n = (size_t)n_faces, clusters = (n + CLUSTER - 1) / CLUSTER;
    cc_scene *s = calloc(1, sizeof *s);
    keyed *sorted = s ? sorted_faces(vertices, faces, n) : NULL;
    if (!sorted) return free(s), NULL;
    size_t room = 3 * n + 8 * clusters + 8; /* given back below */
    s->n_faces = n_faces;
    s->clusters = malloc((clusters + 1) * sizeof *s->clusters), s->faces = malloc((clusters + 1) * sizeof *s->faces);
    s->vertices = malloc(3 * room * sizeof(double));
    s->surfaces = malloc((n + 1) * sizeof *s->surfaces);
    s->part = malloc((n + 1) * sizeof *s->part);
    s->color = malloc(((size_t)n_colors + 1) * sizeof *s->color);
    if (!s->clusters || !s->faces || !s->vertices || !s->surfaces || !s->part || !s->color) {
        free(sorted);
        cc_scene_free(s);
        return NULL;
    }
    size_t used = 0;
    for (size_t i = 0; i < n; i += CLUSTER)
        add_cluster(s, vertices, faces, sorted + i, n - i < CLUSTER ? n - i : CLUSTER, &used);
    free(sorted);
    double *shrunk = realloc(s->vertices, 3 * (used + 8) * sizeof(double));
    if (shrunk) s->vertices = shrunk;
    for (size_t i = 0; i < n; i++) {
        double normal[3];
        unit_normal(vertices, faces + 3 * i, normal);
        for (int k = 0; k < 3; k++) s->surfaces[i].normal[k] = (float)normal[k];
        s->surfaces[i].paint = paint[i];
    }
    for (int64_t i = 0; i < s->n_clusters; i++) set_planes(s, vertices, faces, i);
    memcpy(s->part, part, n * sizeof *part);
    for (size_t i = 0; i < (size_t)n_colors; i++) {
        memcpy(s->color[i], colors + 3 * i, 3 * sizeof *colors);
        s->color[i][3] = 0;
    }
    return s;
}

CC_API void cc_scene_free(cc_scene *s) {
    if (!s) return;
    free(s->clusters), free(s->faces), free(s->vertices);
    free(s->surfaces), free(s->part), free(s->color), free(s);
}

/* ---- workers */

CC_API cc_worker *cc_worker_new(void) { return calloc(1, sizeof(cc_worker)); }

static void sheet_release(sheet *s) {
    aligned_release(s->inverse_z), aligned_release(s->id), free(s->farthest), free(s->changes);
    *s = (sheet){0};
}

CC_API void cc_worker_free(cc_worker *w) {
    if (!w) return;
    for (int g = 0; g < GRIDS; g++) sheet_release(&w->sheets[g]);
    free(w->row), free(w);
}

int sheet_reserve(sheet *s, size_t tiles) {
    if (tiles <= s->capacity) return 1;
    sheet_release(s);
    s->inverse_z = aligned_block(tiles * TILE_AREA * sizeof(float));
    s->id = aligned_block(tiles * TILE_AREA * sizeof(int32_t));
    s->farthest = malloc(tiles * sizeof *s->farthest + 64);
    s->changes = malloc(tiles + 64);
    if (!s->inverse_z || !s->id || !s->farthest || !s->changes) return sheet_release(s), 0;
    s->capacity = tiles;
    return 1;
}

int row_reserve(cc_worker *w, size_t floats) {
    if (floats <= w->row_capacity) return 1;
    free(w->row);
    w->row = calloc(floats + 16, sizeof *w->row); /* vectors reach beyond the last pixel */
    w->row_capacity = w->row ? floats : 0;
    return w->row != NULL;
}

/* ---- instruction sets: the hot files are compiled once for each */

#if CC_HAS_V3
/* By cpuid itself: the compilers' __builtin_cpu_supports answers no under zig. */
static int best_level(void) {
    unsigned a, b, c, d, low, high;
    const unsigned fma_xsave_avx = 1u << 12 | 1u << 27 | 1u << 28, bmi1_avx2_bmi2 = 1u << 3 | 1u << 5 | 1u << 8;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & fma_xsave_avx) != fma_xsave_avx) return 0;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0)); /* does the system save the wide registers? */
    if ((low & 6) != 6 || !__get_cpuid_count(7, 0, &a, &b, &c, &d)) return 0;
    return (b & bmi1_avx2_bmi2) == bmi1_avx2_bmi2;
}
#else
static int best_level(void) { return 0; }
#endif

static atomic_int chosen = -1;

CC_API int32_t cc_choose_variant(int32_t level) {
    int best = best_level();
    atomic_store(&chosen, level < 0 || level > best ? best : level);
    return atomic_load(&chosen);
}

int variant_in_use(void) {
    int level = atomic_load(&chosen);
    return level < 0 ? cc_choose_variant(-1) : level;
}

CC_API const char *cc_variant(void) {
    static const char *names[] = {"baseline", "x86-64-v3"};
    return names[variant_in_use()];
}

/* ---- frames */

static int by_load(const void *one, const void *other) {
    const band_load *a = one, *b = other;
    if (a->candidates != b->candidates) return a->candidates > b->candidates ? -1 : 1;
    return a->first < b->first ? -1 : a->first > b->first;
}

static void order_bands(cc_frame *f) {
    const grid *finest = &f->grids[f->n_grids - 1];
    const int32_t rows = f->band_rows * TILE * finest->n;
    for (int32_t k = 0; k < f->n_bands; k++) f->bands[k] = (band_load){k * f->band_rows, 0};
    for (int64_t i = 0; i < f->n_candidates; i++) {
        const rect *r = &f->candidates[i].where[f->n_grids - 1];
        for (int32_t k = r->y0 / rows; k <= r->y1 / rows; k++) f->bands[k].candidates++;
    }
    qsort(f->bands, (size_t)f->n_bands, sizeof *f->bands, by_load);
}

/* The part of the plane that samples see; without any, no cluster is looked at. */
static void set_limits(cc_frame *f) {
    box all = {-0.5, f->view->width - 0.5, -0.5, f->view->height - 0.5};
    double mx = 0, my = 0;
    if (f->view->lens) {
        all = (box){INFINITY, -INFINITY, INFINITY, -INFINITY};
        for (int g = 0; g < f->n_grids; g++) {
            const box a = f->grids[g].lens->all;
            all.x0 = fmin(all.x0, a.x0), all.x1 = fmax(all.x1, a.x1);
            all.y0 = fmin(all.y0, a.y0), all.y1 = fmax(all.y1, a.y1);
        }
        mx = 1e-6 * (fabs(all.x0) + fabs(all.x1)), my = 1e-6 * (fabs(all.y0) + fabs(all.y1));
    }
    f->n_clusters = all.x0 <= all.x1 ? f->scene->n_clusters : 0;
    f->limits = (box){all.x0 - mx, all.x1 + mx, all.y0 - my, all.y1 + my};
    for (int k = 0; k < 3; k++) /* `ray` is the inverse of the plane's left three columns */
        for (int j = 0; j < 3; j++) f->eye[k] -= f->view->ray[3 * k + j] * f->view->plane[4 * j + 3];
    f->far_x = 1.01 * fmax(fabs(f->limits.x0), fabs(f->limits.x1));
    f->far_y = 1.01 * fmax(fabs(f->limits.y0), fabs(f->limits.y1));
}

static grid grid_of(const cc_view *v, int32_t n) {
    grid g = {n == v->samples ? v->lens : v->centres, n, v->width * n, v->height * n, 0, 0, n, 0.5 * (n - 1)};
    g.tiles_x = (g.width + TILE - 1) / TILE, g.tiles_y = (g.height + TILE - 1) / TILE;
    return g;
}

static void set_grids(cc_frame *f) {
    const cc_view *v = f->view;
    const int colors = v->image || v->coverage || v->rgb, centres = v->depth || v->normal || v->part || v->face;
    if (v->samples == 1 || centres) f->grids[f->n_grids++] = grid_of(v, 1);
    if (v->samples > 1 && (colors || !centres)) f->grids[f->n_grids++] = grid_of(v, v->samples);
}

/* Bands hold whole tiles of either grid, so whole pixels too, and blocks of bent.c, where they can. */
static void set_bands(cc_frame *f) {
    const int32_t tiles_y = (f->view->height + TILE - 1) / TILE, bands = f->view->bands < 1 ? 1 : f->view->bands;
    f->band_rows = (tiles_y + bands - 1) / bands;
    if (f->band_rows >= 8) f->band_rows -= f->band_rows % 8;
    f->n_bands = (tiles_y + f->band_rows - 1) / f->band_rows;
}

CC_API cc_frame *cc_frame_new(const cc_scene *scene, const cc_view *view) {
    cc_frame *f = calloc(1, sizeof *f);
    if (!f) return NULL;
    f->scene = scene, f->view = view;
    set_grids(f), set_bands(f), set_limits(f);
    const size_t room = (size_t)f->n_clusters + 1;
    f->n_shares = (int32_t)(room / SHARE) + 1; /* one at least: whoever ends the last puts the bands in order */
    atomic_init(&f->next_share, 0), atomic_init(&f->shares_left, f->n_shares), atomic_init(&f->next_band, 0);
    f->bands = malloc((size_t)f->n_bands * sizeof *f->bands);
    f->found = malloc((size_t)f->n_shares * sizeof *f->found);
    f->located = malloc(room * sizeof *f->located), f->candidates = malloc(room * sizeof *f->candidates);
    f->depth = malloc(room * sizeof *f->depth);
    if (f->bands && f->found && f->located && f->candidates && f->depth) return f;
    cc_frame_free(f);
    return NULL;
}

CC_API void cc_frame_look(cc_frame *f) {
    if (IN_USE(frame_look)(f)) order_bands(f);
}

CC_API int32_t cc_frame_work(cc_frame *f, cc_worker *worker) { return IN_USE(frame_work)(f, worker); }

CC_API void cc_frame_free(cc_frame *f) {
    if (!f) return;
    free(f->bands), free(f->found), free(f->located), free(f->candidates), free(f->depth), free(f);
}
