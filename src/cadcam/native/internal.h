/* Declarations shared by the C files. */
#ifndef CADCAM_INTERNAL_H
#define CADCAM_INTERNAL_H

#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#include "raster.h"

/* On x86-64 the hot files (hot.h) are compiled twice; a build with one compilation (for sanitizers) says
 * CC_BASELINE_ONLY. */
#if defined(__x86_64__) && !defined(CC_BASELINE_ONLY)
#define CC_HAS_V3 1
#else
#define CC_HAS_V3 0
#endif

enum {
    TILE = 8,        /* tiles are TILE x TILE samples: one row is one 512-bit vector of doubles */
    TILE_AREA = 64,
    CLUSTER = 64,    /* triangles of a cluster, at most */
    SHARE = 512,     /* clusters that a thread looks through at a time */
    CORNERS = 192,   /* vertices of a cluster, at most: an index fits a byte */
    PATCH = 32,      /* samples along the smallest patch of a lens */
    PATCH_LEVELS = 16,
    BEND_LEVELS = 2,
    GRIDS = 2,
};

/* Neighbouring triangles with the box around them: culled, transformed and drawn together. */
typedef struct {
    double low[3], high[3];
    uint32_t first_vertex; /* among those of all clusters; a multiple of 8 */
    uint16_t n_vertices;   /* rounded up to a multiple of 8; the rest repeats the last */
    uint16_t n_faces;
} cluster;

/* A cluster's triangles, all in one place. Their planes in bytes, to tell backs by: 127 times the unit normal, and the
 * distance of the cluster's lowest corner in front of the plane in steps of 1/127 of the three sides of its box
 * together; all 0 where rounding turns the normal. */
typedef struct {
    int8_t x[CLUSTER], y[CLUSTER], z[CLUSTER], offset[CLUSTER];
    uint8_t corner[3][CLUSTER]; /* indices into the vertices of the cluster */
    int32_t id[CLUSTER];        /* the caller's face number */
} face_block;

typedef struct {
    float normal[3]; /* of unit length in the world, 0 without area */
    int32_t paint; /* its colour */
} surface;

struct cc_scene {
    cluster *clusters;
    face_block *faces;       /* of each cluster */
    int64_t n_clusters, n_faces;
    double *vertices;        /* cluster by cluster: its n_vertices x, then their y, then their z */
    surface *surfaces;       /* by face number */
    int32_t *part;           /* by face number */
    float (*color)[4];       /* by paint */
};

typedef struct { int32_t x0, x1, y0, y1; } rect; /* samples, both ends included; empty if x0 > x1 or y0 > y1 */
typedef struct { uint16_t x0, x1, y0, y1; } short_rect;
typedef struct { double x0, x1, y0, y1; } box;   /* of the sampling plane */

/* A lens that is affine to within a bound: the sample (i, j) from some middle looks at
 * (u + ux i + uy j, v + vx i + vy j) of the plane, off by at most (off_u, off_v). */
typedef struct { double u, v, ux, uy, vx, vy, off_u, off_v; } affine;

/* A square part of the picture about (x, y) with its affine map, and the way back: what looks at (u + p, v + q) is the
 * sample (x + xu p + xv q, y + yu p + yv q), off by at most (off_x, off_y). patch.c. */
typedef struct {
    affine map;
    double x, y, xu, xv, yu, yv, off_x, off_y;
    int32_t seen; /* whether any of its samples sees anything */
} patch;

/* One of 2 `half` samples a side with the curvature of the lens: map, and on top of it
 * u2[0] i i + u2[1] i j + u2[2] j j and u3[0] i i i + u3[1] i i j + u3[2] i j j + u3[3] j j j. */
typedef struct {
    affine map; /* about sample (x + half - 1/2, y + half - 1/2) */
    double u2[3], v2[3], u3[4], v3[4];
    int32_t x, y, half;
    int32_t rough;  /* whether it is off by pixels */
    int32_t strong; /* whether its curvature makes pixels */
} bend;

/* What a coordinate has of second and third order about a middle: ii, ij, jj; iii, iij, ijj, jjj. */
typedef struct { double q[3], t[4]; } curves;

/* A coordinate about the sample (x0, y0): map[0] + map[1] i + map[2] j, and where `bent`, curves on top of it. */
typedef struct {
    double x0, y0, map[3];
    curves curves;
    int bent;
} expansion;

typedef struct { double low, high; } range;

struct cc_lens {
    int32_t width, height, tiles_x, tiles_y;
    double *points;   /* of the plane, tile by tile, row by row: TILE x, then their y; NaN where nothing is seen and
                       * beyond the border */
    double *side[4];  /* x0, x1, y0, y1 of the bounds of each tile, once more: 8 tiles are a vector */
    box *block[16];   /* bounds of the points of each tile, of 2 x 2 tiles, 4 x 4 ...; (inf, -inf) where none are */
    uint8_t *partial; /* whether a tile has points without a direction */
    box all;          /* bounds of all points */
    /* Which samples may lie in a part of the plane: a pyramid over a grid of cells in squashed coordinates. */
    double scale_x, scale_y, origin_x, origin_y;
    int32_t levels, cells_x[32], cells_y[32];
    short_rect *cell[32];
    bend *bends[BEND_LEVELS];     /* of PATCH << level samples a side, each half over the one before */
    patch *patches[PATCH_LEVELS]; /* of PATCH << level samples a side, overlapping: step_of in patch.c */
};

/* Where the x of sample k of a tile stands in the table's points; its y stands TILE later. */
static inline size_t point_of(int32_t tile, int k) {
    return (size_t)tile * 2 * TILE_AREA + (size_t)(k / TILE * 2 * TILE + k % TILE);
}

/* Squash the plane to (-1, 1) along each axis, monotonically, so that a grid of equal cells serves 180 degrees. */
static inline double squash(double u) { return u / (1.0 + (u < 0 ? -u : u)); }

/* The samples whose plane points may lie in a box given in cells. */
rect lens_samples(const cc_lens *lens, box cells);

int fill_patches(cc_lens *lens, const double *points); /* 0 where memory is short */
void free_patches(cc_lens *lens);
/* The smallest patch that holds a rectangle. */
const patch *patch_of(const cc_lens *lens, const rect *r);
/* The bend of a level that holds what begins at sample (x, y) and is at most half as wide and high as it, or, where x
 * and y are multiples of that half, as wide and high. */
static inline const bend *bend_at(const cc_lens *lens, int level, int32_t x, int32_t y) {
    const int32_t step = PATCH / 2 << level;
    return &lens->bends[level][(size_t)(y / step) * (size_t)((lens->width + step - 1) / step) + (size_t)(x / step)];
}

/* The samples of a picture, n x n in each pixel: all in one grid. A picture has at most two, the centres (n = 1) and
 * those that its colours are averaged from. Without a lens, pixel x is sample `scale` x + `shift`. */
typedef struct {
    const cc_lens *lens;
    int32_t n, width, height, tiles_x, tiles_y;
    double scale, shift;
} grid;

/* A cluster that may be seen. */
typedef struct {
    uint32_t index;
    float nearest; /* bound of 1/z; inf where it reaches behind the camera */
    rect where[GRIDS];
} candidate;

/* A band by its top row of tiles of centres, and how many candidates it meets. */
typedef struct { int32_t first; int64_t candidates; } band_load;

struct cc_frame {
    const cc_scene *scene;
    const cc_view *view;
    grid grids[GRIDS];
    int32_t n_grids;
    box limits;                              /* of the plane points of all samples, slightly widened */
    double far_x, far_y;                     /* bounds of |x| and |y| there */
    double eye[3];                           /* the camera's centre in the world */
    int64_t n_clusters;                      /* of the scene; 0 where no sample sees anything */
    int32_t n_shares;                        /* parts of them that threads look through, each by itself */
    int32_t *found;                          /* candidates of each share, */
    candidate *located;                      /* which stand where its clusters stand in the scene, */
    double *depth;                           /* and how near they come */
    atomic_int next_share, shares_left;
    candidate *candidates;                   /* nearest first */
    int64_t n_candidates;
    int32_t band_rows;                       /* rows of tiles of centres in a band */
    band_load *bands;                        /* most candidates first: no thread ends alone with a long one */
    int32_t n_bands;
    atomic_int next_band;
};

enum { UNTOUCHED = 255 }; /* among `changes` */

/* What the samples of a band see, tile by tile. */
typedef struct {
    size_t capacity;   /* tiles */
    float *inverse_z;  /* TILE_AREA each; 0 = background */
    int32_t *id;       /* alike; -1 = background */
    float *farthest;   /* lower bound of its 1/z; what is farther is hidden */
    uint8_t *changes;  /* writes since `farthest` was computed; UNTOUCHED: nothing was drawn, nor is the tile cleared */
} sheet;

struct cc_worker {
    sheet sheets[GRIDS];
    float *row; /* one output row of sums, for supersampling */
    size_t row_capacity;
};

int variant_in_use(void); /* the instruction set in use: 0 baseline, 1 x86-64-v3 */

void *aligned_block(size_t bytes); /* 64-byte aligned, not cleared; NULL where memory is short */
void aligned_release(void *block);
int sheet_reserve(sheet *s, size_t tiles); /* 0 where memory is short */
int row_reserve(cc_worker *worker, size_t floats);

#endif
