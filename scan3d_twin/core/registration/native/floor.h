/* What a sweep shows of the floor, on a grid of cells: see costmap.py. */
#pragma once

#include "grids.h"

enum { FREE_CELL = 1, OBSTACLE_CELL = 2, TOUCHED_CELL = 3 };    /* values of a cell, as in costmap.py */

/* A grid (nx, ny) of cells whose side is `side`, from `origin` on. */
typedef struct {
    int64_t *cells, nx, ny;
    const double *origin;
    double side;
} Floor;

/* The lines of a sweep in falling yaw: their directions as `pseudo_angle` from that of the middle, falling
 * too, and how far each sees a free floor. */
typedef struct {
    const double *angles, *reach;
    int64_t n;
} Lines;

/* Return a number that grows with the angle of (c, s): its position along the square |c| + |s| = 1, from -2
 * to 2 over a full turn. */
static inline double pseudo_angle(double c, double s) {
    double length = fabs(c) + fabs(s), at = length > 0 ? s / length : 0;
    return c >= 0 ? at : s >= 0 ? 2 - at : -2 - at;
}

/* Return `pseudo_angle` of any angle; each full turn adds 4. */
static double unwrapped_pseudo_angle(double angle) {
    double turns = floor(angle / TAU + 0.5);
    Turn rest = turn_by(angle - turns * TAU);
    return 4 * turns + pseudo_angle(rest.c, rest.s);
}

/* Return the cell of a coordinate, limited to 0 .. n. */
static int64_t cell_within(double at, double origin, double side, int64_t n) {
    double cell = floor((at - origin) / side);
    return cell < 0 ? 0 : cell > (double)n ? n : (int64_t)cell;
}

/* Mark the cells free whose middle lies between two lines and within the reach of both, but no touched one.
 * The lines turn about a place (x, y); (c, s) is the direction of the middle one. Cells from `first` to before
 * `end` are looked at. */
static void mark_between(const Floor *grid, const int64_t first[2], const int64_t end[2], const double *pose,
                         Turn middle, const Lines *lines) {
    int64_t left = 0;
    for (int64_t i = first[0]; i < end[0]; i++)
        for (int64_t j = first[1]; j < end[1]; j++) {
            double x = grid->origin[0] + ((double)i + 0.5) * grid->side - pose[0];
            double y = grid->origin[1] + ((double)j + 0.5) * grid->side - pose[1];
            double angle = pseudo_angle(middle.c * x + middle.s * y, middle.c * y - middle.s * x);

            /* the last line to the left, near that of the cell before */
            while (left + 1 < lines->n && lines->angles[left + 1] >= angle) left++;
            while (left >= 0 && lines->angles[left] < angle) left--;
            if (left < 0 || left >= lines->n - 1) continue;

            double a = lines->reach[left], b = lines->reach[left + 1], both = a < b ? a : b;
            int64_t *cell = grid->cells + i * grid->ny + j;
            if (both >= 0 && x * x + y * y <= both * both && *cell != TOUCHED_CELL) *cell = FREE_CELL;
        }
}

/* Mark what a sweep shows of the floor: free where two neighbouring lines at `yaws` (n,) see it within their
 * `reach` (n,), then obstacles at `points` (m, 2). Touched cells are kept. `pose` is the sweep's x, y, cosine
 * and sine of yaw. Return 0, or -1 if memory runs out. */
static int mark_floor(const Floor *grid, const double *pose, const double *yaws, const double *reach,
                      int64_t n, const double *points, int64_t m) {
    /* directions from that in the middle of the sweep */
    double *angles = malloc(sizeof *angles * (size_t)(n + 1)), farthest = 0, widest = 0;
    if (!angles) return -1;
    double centre = n > 0 ? (yaws[0] + yaws[n - 1]) / 2 : 0;
    double low[2] = {pose[0], pose[1]}, high[2] = {pose[0], pose[1]};
    for (int64_t k = 0; k < n; k++) {
        angles[k] = unwrapped_pseudo_angle(yaws[k] - centre);

        /* bound what the lines sweep: their ends */
        Turn turn = turn_by(yaws[k]);
        double end[2] = {pose[0] + reach[k] * (pose[2] * turn.c - pose[3] * turn.s),
                         pose[1] + reach[k] * (pose[3] * turn.c + pose[2] * turn.s)};
        for (int d = 0; d < 2; d++) {
            low[d] = end[d] < low[d] ? end[d] : low[d];
            high[d] = end[d] > high[d] ? end[d] : high[d];
        }
        farthest = reach[k] > farthest ? reach[k] : farthest;
        if (k > 0) widest = yaws[k - 1] - yaws[k] > widest ? yaws[k - 1] - yaws[k] : widest;
    }

    /* and the bulge of an arc over its chord */
    widest = widest < 2 * HALF_PI_HIGH ? widest : 2 * HALF_PI_HIGH;
    double margin = farthest * (1 - turn_by(widest / 2).c) + grid->side;
    const int64_t size[2] = {grid->nx, grid->ny};
    int64_t first[2], end[2];
    for (int d = 0; d < 2; d++) {
        first[d] = cell_within(low[d] - margin, grid->origin[d], grid->side, size[d]);
        end[d] = cell_within(high[d] + margin + grid->side, grid->origin[d], grid->side, size[d]);
    }

    /* mark free cells, then obstacles */
    Turn turn = turn_by(centre), middle = {pose[2] * turn.c - pose[3] * turn.s,
                                           pose[3] * turn.c + pose[2] * turn.s};
    Lines lines = {angles, reach, n};
    if (n > 0) mark_between(grid, first, end, pose, middle, &lines);
    free(angles);
    for (int64_t k = 0; k < m; k++) {
        double u = points[2 * k], v = points[2 * k + 1];
        double i = (pose[0] + pose[2] * u - pose[3] * v - grid->origin[0]) / grid->side;
        double j = (pose[1] + pose[3] * u + pose[2] * v - grid->origin[1]) / grid->side;
        if (!(i >= 0 && j >= 0 && i < (double)grid->nx && j < (double)grid->ny)) continue;
        int64_t *cell = grid->cells + (int64_t)i * grid->ny + (int64_t)j;
        if (*cell != TOUCHED_CELL) *cell = OBSTACLE_CELL;
    }
    return 0;
}
