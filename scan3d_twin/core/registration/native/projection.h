/* Projection of a point onto the reading of a sweep that sees it: projection.py describes the method. */
#pragma once

#include "edges.h"

#define QUARTER (CELLS / 4)
#define MAX_SPACINGS_OFF 0.75   /* largest distance of a direction from its line or beam, in spacings */

enum { CELLS = 16384 }; /* entries of a table over a full turn: 0.016 to 0.031 deg each */

/* Return the pseudo-angle of a direction (c, s) in cells of the tables, 0 to CELLS. */
static inline double angle_in_cells(double c, double s) {
    double shrunk = 1 / (fabs(c) + fabs(s) + 1e-9), way = s * shrunk;
    way = c < 0 ? 2 - way : s < 0 ? 4 + way : way;
    return QUARTER * way;
}

/* Return the cells per radian at the direction (c, s). */
static inline double cells_per_radian(double c, double s) {
    double shrunk = 1 / (fabs(c) + fabs(s) + 1e-9);
    return QUARTER * (c * c + s * s) * shrunk * shrunk;
}

/* Elevation and yaw at which a point is seen, in cells, and the cells per radian of yaw there. */
typedef struct {
    double elevation, yaw, rate;
} Direction;

static inline Direction direction_to(double x, double y, double z, double branch, const double *mount) {
    double cos_kappa = mount[0], sin_kappa = mount[1], a = mount[2], k_t = mount[3], k_z = mount[4];
    const double *t = mount + 5, *x_axis = mount + 8, *z_axis = mount + 11;
    double rho = sqrt(x * x + y * y);
    rho = rho > 1e-9 ? rho : 1e-9;
    double sine = (k_t - k_z * z) / (a * rho);
    sine = sine > 1 ? 1 : sine < -1 ? -1 : sine;
    double cosine = branch * sqrt(1 - sine * sine);
    double c = cos_kappa * cosine - sin_kappa * sine, s = sin_kappa * cosine + cos_kappa * sine;
    double forward = rho * c - t[0], left = rho * s - t[1], up = z - t[2];
    double ahead = forward * x_axis[0] + left * x_axis[1] + up * x_axis[2];
    double above = forward * z_axis[0] + left * z_axis[1] + up * z_axis[2];
    double yaw_c = x * c + y * s, yaw_s = y * c - x * s;
    return (Direction){angle_in_cells(ahead, above), angle_in_cells(yaw_c, yaw_s),
                       cells_per_radian(yaw_c, yaw_s)};
}

/* Return the beam of a line nearest to an elevation in cells, among those around the nominal one; -1 if there
 * is none. */
static int32_t nearest_beam(double elevation, int32_t line, int32_t nominal, const Projection *p) {
    const double *own = p->elevations + line * p->n_beams;
    int64_t low = nominal > p->search ? nominal - p->search : 0;
    int64_t high = nominal + p->search < p->n_beams ? nominal + p->search : p->n_beams - 1;
    double least = CELLS;
    int32_t nearest = -1;
    for (int64_t j = low; j <= high; j++) {
        double off = fabs(own[j] - elevation);
        off = off > CELLS / 2 ? fabs(CELLS - off) : off;
        nearest = off < least ? (int32_t)j : nearest;
        least = off < least ? off : least;
    }
    return nearest;
}

/* Return the flat index of the reading in this direction, or -1; without branches if lines agree. The base
 * turns by some cells during the tenth of a second of a line, so the yaw of the beam itself decides on the
 * line. */
static inline int32_t reading_at(double elevation, double yaw, double rate, const Projection *p) {
    int32_t beam = p->beams[(int32_t)elevation & (CELLS - 1)];
    int32_t line = p->lines[(int32_t)yaw & (CELLS - 1)];
    int64_t at = line > 0 ? line : 0;
    double turned = p->yaws[at * p->n_beams + (beam > 0 ? beam : 0)] - p->middles[at];
    line = p->lines[(int32_t)(yaw - turned * rate + CELLS) & (CELLS - 1)];
    if (p->elevations && line >= 0 && beam >= 0) beam = nearest_beam(elevation, line, beam, p);
    return (line >= 0) & (beam >= 0) ? (int32_t)(line * p->n_beams + beam) : -1;
}

enum { AHEAD = 1, BEHIND = -1 };

static inline int32_t reading_of(double x, double y, double z, int branch, const Projection *p) {
    Direction way = direction_to(x, y, z, branch, p->mount);
    return reading_at(way.elevation, way.yaw, way.rate, p);
}

/* Write `n` angles in cells. */
static void locate_angles(const double *angles, int64_t n, double *cells) {
    for (int64_t k = 0; k < n; k++) {
        Turn turn = turn_by(angles[k]);
        cells[k] = angle_in_cells(turn.c, turn.s);
    }
}

/* Write the angles in the middle of the cells (CELLS,). */
static void write_cell_centres(double *centres) {
    for (int64_t k = 0; k < CELLS; k++) {
        double around = ((double)k + 0.5) * 4 / CELLS, share = around - floor(around);
        centres[k] = floor(around) * HALF_PI_HIGH + angle_of(1 - share, share);
    }
}

/* Return the first cell whose centre is at least `angle`. */
static int64_t cell_from(const double *centres, double angle) {
    int64_t low = 0, high = CELLS;
    while (low < high) {
        int64_t middle = (low + high) / 2;
        if (centres[middle] < angle) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* Write for each cell the index of the nearest of `n` angles, typically `spacing` apart, or -1 where none
 * is near. Return 0, or -1 if memory runs out. */
static int tabulate_nearest(const double *angles, int64_t n, double spacing, const double *centres,
                            int32_t *table) {
    double *around = malloc(sizeof *around * (size_t)(n + 2));
    int32_t *index = malloc(sizeof *index * (size_t)(n + 2));
    int failed = !around || !index;
    for (int64_t c = 0; c < CELLS; c++) table[c] = -1;
    if (failed || n == 0) goto done;

    /* sort by angle: already monotonic but for one wrap */
    int falling = angles[n - 1] < angles[0];
    for (int64_t k = 0; k < n; k++) {
        int64_t own = falling ? n - 1 - k : k, at = k;
        double angle = angles[own] - TAU * floor(angles[own] / TAU);
        for (; at > 0 && around[at] > angle; at--)
            around[at + 1] = around[at], index[at + 1] = index[at];
        around[at + 1] = angle, index[at + 1] = (int32_t)own;
    }
    around[0] = around[n] - TAU, index[0] = index[n];
    around[n + 1] = around[1] + TAU, index[n + 1] = index[1];

    /* cells up to halfway to the neighbours, within reach */
    double reach = MAX_SPACINGS_OFF * spacing > TAU / CELLS ? MAX_SPACINGS_OFF * spacing : TAU / CELLS;
    for (int64_t k = 0; k < n + 2; k++) {
        double low = around[k] - reach, high = around[k] + reach;
        if (k > 0) {
            double halfway = (around[k - 1] + around[k]) / 2;
            low = low > halfway ? low : halfway;
        }
        if (k < n + 1) {
            double halfway = (around[k] + around[k + 1]) / 2;
            high = high < halfway ? high : halfway;
        }
        for (int64_t c = cell_from(centres, low); c < CELLS && centres[c] < high; c++)
            table[c] = index[k];
    }
done:
    free(around);
    free(index);
    return failed ? -1 : 0;
}

/* Write the flat index of the reading that sees each point, or -1. Where two readings see it, the one ahead
 * of the axis counts, unless `seen` is 0 there. */
static void find_readings(const Projection *p, const double *points, int64_t n, const uint8_t *seen,
                          int64_t *found) {
    for (int64_t m = 0; m < n; m++) {
        const double *at = points + 3 * m;
        found[m] = reading_of(at[X], at[Y], at[Z], AHEAD, p);
        if (!p->backwards || (found[m] >= 0 && seen[found[m]])) continue;
        int32_t behind = reading_of(at[X], at[Y], at[Z], BEHIND, p);
        if (behind >= 0 && seen[behind]) found[m] = behind;
    }
}
