/* The border of the compiled engine: the values that cross it.
 *
 * Arrays are dense, row by row, and belong to the caller. Lengths are in metres, angles in radians.
 * A function that is exported ends in the level of the processor that it is compiled for (engine.c);
 * Python's side of the border is __init__.py. */
#pragma once

#include <stddef.h>
#include <stdint.h>

enum { X, Y, Z, NX, NY, NZ, VARIANCE, NORMAL_VARIANCE, SURFEL };
/* A surfel is SURFEL doubles: its point on the ray, its unit normal towards the lidar, the variance
 * of one reading along the normal [m2], and that of the normal [rad2]. */

enum { PLACE_X, PLACE_Y, ACROSS_X, ACROSS_Y, EDGE_VARIANCE, SIDE, LOW, HIGH, EDGE };
/* An edge is EDGE doubles: place and direction across the ray in the top view, variance of the place
 * along it [m2], 1 where the surface ends to the right or -1, and its lowest and highest point. */

enum { UNSEEN, EMPTY, SURFACE };
/* What a reading knows of its ray. */

enum { POSE = 6, NUISANCES = 2, STATE = POSE + NUISANCES };
/* Most entries of the state: x y z rx ry rz of the pose, then errors that all readings share. Today
 * there is one, the relative error of the yaws. */

/* A sweep: lines by beams. Each reading has a yaw, a range and a validity of its own; rays may be
 * those of the lidar for all lines, or one set a line. */
typedef struct {
    int64_t n_lines, n_beams;
    int64_t stride;         /* readings from one line to the next, in all arrays of readings */
    const double *ranges;   /* readings */
    const double *yaws;     /* readings: of the base, from the middle of the sweep */
    const double *rays;     /* unit vectors in `base` (n_beams, 3), or (n_lines, n_beams, 3) */
    int64_t ray_stride;     /* doubles from the rays of one line to the next; 0 where all share them */
    const double *lever;    /* place of the lidar in `base` (3,) */
    const double *sigmas;   /* readings: standard deviation of the range; NULL to estimate it */
    double beam_spacing;    /* typical angle between two beams */
} Sweep;

/* What a sweep shows, written by `survey`; the caller provides the arrays. */
typedef struct {
    double *rows;           /* surfels, line by line, at most one a reading */
    double *yaws;           /* yaw of each surfel's reading, from the middle of the sweep */
    int32_t *index;         /* readings: row of the surfel, or -1 */
    uint8_t *valid;         /* readings: 1 where it is a distance */
    double noise[3];        /* range sigma at 0, its growth per metre, sigma of a line's yaw */
    double line_spacing;    /* typical angle between two lines */
    int64_t count;          /* of the surfels */
} Survey;

/* From a point to the reading of a sweep that sees it: see projection.py. */
typedef struct {
    int64_t n_lines, n_beams;
    const int32_t *lines;   /* line by yaw of its middle beam (CELLS,), or -1 */
    const int32_t *beams;   /* beam by elevation (CELLS,), or -1: one table, or one a line */
    int64_t beam_stride;    /* cells from the table of one line to the next; 0 where all share it */
    const double *yaws;     /* readings */
    const double *middles;  /* yaw of each line's middle beam (n_lines,) */
    const double *mount;    /* (14,) */
    int64_t backwards;      /* whether any beam looks back over the zenith or the nadir */
} Projection;

/* What other sweeps are laid on. */
typedef struct {
    const double *rows;     /* surfels */
    const double *yaws;     /* of each surfel */
    const int32_t *index;   /* readings: row, or -1 */
    const double *edges;
    int64_t n_edges;
    Projection projection;
} Target;

/* Surfels of a sweep, every `stride`-th along lines and beams: each stands for stride^2. */
typedef struct {
    int64_t count, stride;
    int64_t room;           /* doubles from one column to the next */
    double *columns;        /* surfels, column by column (SURFEL, room), sorted by line */
    double *yaws;
    int32_t *lines;         /* of each, ascending */
} Sample;

/* What the iteration lays on the target. */
typedef struct {
    Sample coarse;          /* for the first steps */
    Sample fine;            /* for those at the last gate */
    Sample every;           /* for the one after these have settled */
    const double *edges;
    int64_t n_edges;
    double first[3];        /* mean of the points */
    double second[9];       /* mean of p p^T */
} Source;

/* What two sweeps err by beside the noise of single readings: see point_to_plane.py. */
typedef struct {
    double jitter, target_jitter, density, share, tilt;
} PairNoise;

/* What is known beforehand. */
typedef struct {
    double mean[16];        /* T_target_source */
    double covariance[36];  /* of x y z rx ry rz; its first entry is 0 where nothing is known */
    int64_t n_entries;      /* of the pose that are estimated ... */
    int64_t entries[POSE];  /* ... and which, ascending */
    int64_t n_nuisances;
    double nuisance_information[NUISANCES];  /* of the common errors; infinite where there is none */
} Prior;

/* When the iteration ends, and the widest gate. */
typedef struct {
    int64_t max_iterations;
    double translation_epsilon, rotation_epsilon, max_correspondence_distance;
} Criteria;

/* Which pairs count: most distance along the normal, and c of the weights in standard deviations. */
typedef struct {
    double distance, robust;
} Gate;

/* J^T W J step = -J^T W e on `size` entries: those of the pose that are estimated, then nuisances.
 * Matrices are (size, size) in the first rows and columns of (STATE, STATE). */
typedef struct {
    int64_t size;
    double information[STATE * STATE];
    double lost[STATE * STATE];     /* what of it the yaw jitter leaves unknown */
    double gradient[STATE];         /* less what is lost */
    double spurious[STATE * STATE]; /* what noise of the normals adds to the pose's part */
    int64_t pairs;
    double square;                  /* sum of their squared residuals */
} Equations;

/* Where the iteration from one start ended, and what is known there about the target's origin. */
typedef struct {
    double T[16];                   /* T_target_source */
    double nuisances[NUISANCES];
    double covariance[36], information[36];
    double degenerate[POSE * POSE]; /* directions (n_degenerate, 6) that nothing determines */
    int64_t n_degenerate;
    double predicted_rmse;          /* RMS displacement of the source's surfels to be expected */
    double square;
    int64_t pairs, surfels, iterations, settled, overlap;
} Outcome;
