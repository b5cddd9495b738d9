/* Which points and edges a rendered view shows, by its own depth and normals.
 *
 * Plain C11 like raster.h; every function writes its answers into memory of the caller. */
#ifndef CADCAM_SEEN_H
#define CADCAM_SEEN_H

#include <stdint.h>

#include "raster.h"

/* A view: depth (height, width) z in mm at pixel centres, infinite where there is nothing; normal (height, width, 3)
 * unit normals in the camera's axes; px, py what a pixel is wide and high in the plane (x, y)/z, 1/f. A point is seen
 * if at one of the four pixel centres around it nothing is in front: the plane of the face there, continued to the
 * point's ray by at most `steepest` of its depth, lies no more than `slack` of the point's depth nearer. */
typedef struct {
    const float *depth, *normal;
    float px, py, slack, steepest;
    int32_t width, height;
} cc_depth_view;

/* Points p (n, 3) mm in the camera's axes and their pixels q (n, 2): out (n) is 1 for seen, 0 for hidden, behind the
 * camera or outside the picture. */
CC_API void cc_seen(const cc_depth_view *view, int64_t n, const double *p, const double *q, uint8_t *out);

/* When an edge is drawn: always; if one of its faces is turned to the camera; if exactly one is. */
enum { CC_ALWAYS, CC_FACING, CC_TURNING };

/* Straight edges in space: ends (n, 2, 3) mm, each with the planes (n, 2) of its faces and one of the rules above.
 * Edges of equal chain that follow one another run on head to tail. */
typedef struct {
    const double *ends;
    const int32_t *sides, *chain;
    const uint8_t *rule;
    int64_t n;
} cc_edges;

/* A camera without distortion: camera_from_world (3, 4), K (2, 3), and the least z that it sees, mm. */
typedef struct {
    double pose[12], K[6], near;
} cc_eye_point;

/* Polylines: points q (px), p (mm, in space), and the edge that leads away from each, or at a line's end led to it;
 * line m begins at start[m]. `room`: how many points, and lines, there is memory for. */
typedef struct {
    double *q, *p;
    int32_t *edge, *start;
    int64_t room, points, lines;
} cc_lines;

/* Stretches of the edges that the view shows, cut at the picture's border, joined along chains, but for points within
 * `bend` px of the straight line without them; lines shorter than `shortest` px are left out. front[i] says whether the
 * camera is in front of plane i. Sets lines->points and lines->lines; where one of them is more than the room, what is
 * written is not all: call again with more. */
CC_API void cc_seen_edges(const cc_depth_view *view, const cc_eye_point *eye, const cc_edges *edges,
                          const uint8_t *front, double step, double shortest, double bend, cc_lines *lines);

#endif
