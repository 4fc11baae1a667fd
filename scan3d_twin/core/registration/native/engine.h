/* The structures that Python passes to the compiled engine and reads back.
 *
 * Arrays are dense, row-major and owned by the caller. Lengths are in metres, angles in radians. The
 * name of an exported function ends in the processor level that it is compiled for (engine.c);
 * __init__.py mirrors these structures. */
#pragma once

#include <stddef.h>
#include <stdint.h>

enum { X, Y, Z, NX, NY, NZ, VARIANCE, NORMAL_VARIANCE, SURFEL };
/* A surfel is SURFEL doubles: its point on the ray, its unit normal towards the lidar, the variance
 * of one reading along the normal [m2], and the variance of the normal's direction [rad2]. */

enum { PLACE_X, PLACE_Y, ACROSS_X, ACROSS_Y, EDGE_VARIANCE, SIDE, LOW, HIGH, EDGE };
/* An edge is EDGE doubles: its position in the top view, the unit vector across the ray, the variance of
 * the position along that vector [m2], 1 where the surface ends to the right and -1 where it ends to the
 * left, and the z of its lowest and highest point. */

enum { UNKNOWN_RAY, EMPTY_RAY, SURFACE_RAY };
/* What a reading says about its ray: nothing, that it is empty, or that it ends on a surface. */

enum { RANGE_SIGMA, RANGE_GROWTH, YAW_SIGMA, CORRELATION, NOISES };
/* Noise of a sweep: range sigma at 0 m [m], its growth per metre, the sigma of a line's yaw [rad], and the
 * factor on the variance of a mean along a line, as neighbouring beams have correlated noise. */

enum { POSE = 6, NUISANCES = 2, STATE = POSE + NUISANCES };
/* The state has at most these entries: x y z rx ry rz of the pose, then nuisance parameters that all
 * readings share. One is in use, the relative error of the yaws (the yaw scale). */

/* A sweep of lines by beams. Each reading has its own yaw, range and validity. All lines may share one
 * set of rays, or each line may have its own. */
typedef struct {
    int64_t n_lines, n_beams;
    int64_t stride;         /* readings from one line to the next, in every array of readings */
    const double *ranges;   /* per reading */
    const double *yaws;     /* per reading: yaw of the base, relative to the middle of the sweep */
    const double *rays;     /* unit vectors in `base` (n_beams, 3), or (n_lines, n_beams, 3) */
    int64_t ray_stride;     /* doubles from the rays of one line to the next; 0 if all lines share them */
    const double *lever;    /* position of the lidar in `base` (3,) */
    const double *sigmas;   /* per reading: standard deviation of the range; NULL to estimate it */
    double beam_spacing;    /* typical angle between two beams */
    double max_range;       /* beyond which nothing returns */
} Sweep;

/* The surfels of a sweep and its noise, written by `extract_surfels` into the caller's arrays. */
typedef struct {
    double *rows;           /* surfels, line by line, at most one per wanted reading */
    double *yaws;           /* yaw of each surfel's reading, relative to the middle of the sweep */
    int32_t *index;         /* per reading: row of its surfel, or -1 */
    const uint8_t *valid;   /* per reading: 1 where it is a distance */
    double noise[NOISES];
    double line_spacing;    /* typical angle between two lines */
    int64_t count;          /* number of surfels */
} ScanSurfels;

/* Projection of a point onto the reading of a sweep that sees it: see projection.py. */
typedef struct {
    int64_t n_lines, n_beams;
    const int32_t *lines;   /* line by yaw of its middle beam (CELLS,), or -1 */
    const int32_t *beams;   /* beam by nominal elevation (CELLS,), or -1 */
    const double *elevations;   /* per reading, in cells, infinite if there is none; NULL if lines agree */
    int64_t search;         /* beams to either side of the nominal one that may be the nearest */
    const double *yaws;     /* per reading */
    const double *middles;  /* yaw of each line's middle beam (n_lines,) */
    const double *mount;    /* (14,) */
    int64_t backwards;      /* whether any beam looks back over the zenith or the nadir */
} Projection;

/* The sweep that others are registered to. */
typedef struct {
    const double *rows;     /* surfels */
    const double *yaws;     /* per surfel */
    const int32_t *index;   /* per reading: row of its surfel, or -1 */
    const double *edges;
    int64_t n_edges;
    Projection projection;
} Target;

/* Every `stride`-th surfel of a sweep along lines and beams; each represents stride^2 of them. */
typedef struct {
    int64_t count, stride;
    const double *rows;     /* all surfels of the sweep */
    const double *yaws;     /* of all its surfels */
    int32_t *chosen;        /* row of each surfel of the sample (count,) */
    int32_t *lines;         /* its line, ascending (count,) */
} Sample;

/* The sweep that the iteration moves onto the target. */
typedef struct {
    Sample coarse;          /* for the first steps */
    Sample fine;            /* for the steps at the final gate */
    Sample every;           /* for the last step, after the iteration has converged */
    const double *edges;
    int64_t n_edges;
    double first[3];        /* mean of the points p */
    double second[9];       /* mean of p p^T */
} Source;

/* Errors of two sweeps beyond the noise of single readings: see point_to_plane.py and shared_errors.py. */
typedef struct {
    double jitter, target_jitter, density, share, tilt;
    double patch, linearity, offset;    /* standard deviations of errors that readings share [m] */
    double correlation;                 /* factor on variances of means for correlation along beams */
    double height, lean;                /* of an uneven floor: z [m], roll and pitch [rad] */
    double ahead, up;                   /* place of the source's lidar in `base` [m] */
} PairNoise;

/* Prior distribution of the pose and the nuisance parameters. */
typedef struct {
    double mean[16];        /* T_target_source */
    double covariance[36];  /* of x y z rx ry rz; its first entry is 0 if there is no prior */
    int64_t n_entries;      /* number of estimated entries of the pose */
    int64_t entries[POSE];  /* the estimated entries, ascending */
    int64_t n_nuisances;
    double nuisance_information[NUISANCES];  /* infinite where a nuisance is known exactly */
} Prior;

/* Convergence criteria of the iteration, and its first gate. */
typedef struct {
    int64_t max_iterations;
    double translation_epsilon, rotation_epsilon, max_correspondence_distance;
} Criteria;

/* Gate for correspondences: largest distance along the normal, scale c of the robust kernel in standard
 * deviations, and cosine between the normals at which a pair's weight is 0. */
typedef struct {
    double distance, robust, cosine;
} Gate;

/* Normal equations J^T W J step = -J^T W e on `size` entries: the estimated entries of the pose, then the
 * nuisances. Matrices are (size, size) in the first rows and columns of (STATE, STATE). */
typedef struct {
    int64_t size;
    double information[STATE * STATE];
    double lost[STATE * STATE];     /* information lost to yaw jitter, to be subtracted */
    double gradient[STATE];         /* jitter already marginalised */
    double spurious[STATE * STATE]; /* information on the pose that noise of the normals adds */
    int64_t pairs;                  /* number of correspondences */
    double square;                  /* sum of their squared residuals */
} Equations;

/* Result of the iteration from one start; covariance and information are about the target's origin. */
typedef struct {
    double T[16];                   /* T_target_source */
    double nuisances[NUISANCES];
    double covariance[36], information[36];
    double degenerate[POSE * POSE]; /* degenerate directions (n_degenerate, 6) */
    int64_t n_degenerate;
    double predicted_rmse;          /* expected RMS displacement of the source's surfels */
    double square;                  /* sum of the squared residuals */
    double spread;                  /* of the errors that all readings share, in usual ones; NaN: not known */
    int64_t pairs, surfels, iterations, settled, overlap;
} RunResult;
