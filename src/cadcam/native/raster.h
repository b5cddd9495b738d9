/* The rasteriser's C interface: plain C11, no Python headers, no state outside the objects made here.
 *
 * A picture is a function of points (x, y) of a *sampling plane*: `plane` maps a world point X (mm, homogeneous) to
 * P = plane (X, 1), whose plane point is (P0/P2, P1/P2) and whose depth is P2. Without a lens table the plane is that
 * of the pixels (plane = K [R|t], the centre of the top-left pixel at (0, 0)); with one it is the undistorted plane
 * (plane = [R|t]) and the table says where in it each pixel's centre lies. No vertex is ever distorted or clipped.
 *
 * Threads: scenes and lenses are read-only once made. One thread calls cc_frame_new; then any number call
 * cc_frame_look, until all have returned; then any number cc_frame_work, each with a worker of its own, until all have
 * returned; then cc_frame_free.
 */
#ifndef CADCAM_RASTER_H
#define CADCAM_RASTER_H

#include <stdint.h>

#if defined(_WIN32)
#define CC_API __declspec(dllexport)
#else
#define CC_API __attribute__((visibility("default")))
#endif

typedef struct cc_scene cc_scene;   /* triangles, grouped into clusters of neighbours */
typedef struct cc_lens cc_lens;     /* where each pixel of a distorting camera looks */
typedef struct cc_worker cc_worker; /* one thread's scratch memory */
typedef struct cc_frame cc_frame;   /* one picture being made */

typedef struct {
    double plane[12]; /* 3x4, row by row: world -> homogeneous sampling plane */
    double ray[9];    /* 3x3, row by row: plane point (x, y, 1) -> direction in the world */
    double rotation[9]; /* 3x3, row by row: world -> camera, for the normals */
    double fill_from[3], back_from[3]; /* unit vectors in the world towards the distant lights */
    float ambient, head, fill, back;
    float background[3];
    int32_t width, height;  /* of the output, px */
    int32_t samples;        /* n: image, coverage and rgb average n x n samples; all else is of the pixels' centres */
    int32_t bands;          /* number of horizontal bands handed out to workers */
    int32_t fronts;         /* leave out triangles that show their back: clockwise as the camera sees them */
    const cc_lens *lens;    /* of n times the width and height; NULL: no distortion */
    const cc_lens *centres; /* of the pixels themselves; `lens` once more if n == 1 */
    float *image, *coverage, *depth, *normal; /* (H,W,3) (H,W) (H,W) (H,W,3), each or NULL */
    int32_t *part, *face;                     /* (H,W), each or NULL */
    uint8_t *rgb;                             /* (H,W,3), or NULL: the image in steps of 1/255, rounded */
} cc_view;

/* `paint` numbers the colour of each face. NULL where memory is short. Every index must be in range and every
 * coordinate finite: the caller checks. */
CC_API cc_scene *cc_scene_new(const double *vertices, const int32_t *faces, int64_t n_faces, const int32_t *part,
                              const int32_t *paint, const float *colors, int64_t n_colors);
CC_API void cc_scene_free(cc_scene *scene);
/* Of points p (n, 3) in the world: out (n) is 1 where a triangle, either side of it, meets the open line between the
 * point and the eye while the point lies more than `tolerance` off the triangle's plane; 0 elsewhere. */
CC_API void cc_scene_hides(const cc_scene *scene, const double eye[3], double tolerance, int64_t n, const double *p,
                           uint8_t *out);

/* `points` (H, W, 2): the plane point of each pixel's centre, NaN where it sees nothing. NULL where memory is short. */
CC_API cc_lens *cc_lens_new(const double *points, int32_t width, int32_t height);
CC_API void cc_lens_free(cc_lens *lens);

CC_API cc_worker *cc_worker_new(void);
CC_API void cc_worker_free(cc_worker *worker);

/* NULL where memory is short. `view` and all it points to must outlive the frame. */
CC_API cc_frame *cc_frame_new(const cc_scene *scene, const cc_view *view);
/* Find out which triangles may be seen. */
CC_API void cc_frame_look(cc_frame *frame);
/* Render bands until none is left; 0, or -1 where memory is short (then the frame is incomplete). */
CC_API int32_t cc_frame_work(cc_frame *frame, cc_worker *worker);
CC_API void cc_frame_free(cc_frame *frame);

/* The instruction set in use ("x86-64-v3" or "baseline"), and its choice by number: -1 = best available. */
CC_API const char *cc_variant(void);
CC_API int32_t cc_choose_variant(int32_t level);

#endif
