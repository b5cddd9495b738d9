/* The bodies of the interface's functions that are compiled once for each instruction set, in the hot files (hot.h).
 * Each has the type of its function: whoever defines or calls it otherwise does not compile. */
#ifndef CADCAM_BODIES_H
#define CADCAM_BODIES_H

#include "correlate.h"
#include "field.h"
#include "internal.h"
#include "profile.h"

#if CC_HAS_V3
#define BODIES(type, name) extern type name##_baseline, name##_v3;
#define IN_USE(name) (variant_in_use() == 1 ? name##_v3 : name##_baseline)
#else
#define BODIES(type, name) extern type name##_baseline;
#define IN_USE(name) name##_baseline
#endif
#define BODIES_OF(function, name) BODIES(__typeof__(function), name)

typedef int look(cc_frame *frame); /* whether it was the last to be done */
/* What an expansion leaves of coordinate k, 0 or 1, of all points of a rectangle that begins with a whole tile. None is
 * left out but those without a direction, NaN in the table: the numbers given are finite. */
typedef range leave(const cc_lens *l, const rect *r, int k, const expansion *of);

BODIES(look, frame_look)
BODIES(leave, left_by)
BODIES_OF(cc_frame_work, frame_work)
BODIES_OF(cc_shrink, shrink)
BODIES_OF(cc_find_spots, spots)
BODIES_OF(cc_search_rows, search_rows)
BODIES_OF(cc_register_poses, register_poses)
BODIES_OF(cc_register_pulls, register_pulls)
BODIES_OF(cc_reduce, field_reduce)
BODIES_OF(cc_straighten, field_straighten)
BODIES_OF(cc_directions, field_directions)
BODIES_OF(cc_halve, field_halve)
BODIES_OF(cc_slide, climb_slide)
BODIES_OF(cc_sweep, sweep_field)
BODIES_OF(cc_climb, climb_poses)
BODIES_OF(cc_evidence, climb_evidence)
BODIES_OF(cc_step_sums, step_sums)
BODIES_OF(cc_steps, steps)
BODIES_OF(cc_step_residuals, step_residuals)
BODIES_OF(cc_candidates, slope_extrema)

#endif
