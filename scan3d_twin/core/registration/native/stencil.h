/* Difference and slope of a quantity across seven lines of a sweep, evenly spaced or not: scan_noise.py says
 * what for. */
#pragma once

#include "engine.h"
#include "lanes.h"
#include <math.h>

#define SQUARES 924.0           /* sum of the squares of the SIXTH: variance of a difference of unit noise */
#define MIN_NORM 1e-6           /* of a power of the yaw without the lower ones: less is rounding */

enum {
    REACH = 3,                  /* lines to each side that a sixth difference takes */
    SLOPE_REACH = 2,            /* lines to each side that a slope takes */
    ACROSS = 2 * REACH + 1,     /* lines of a sixth difference */
    POWERS = 5,                 /* of the yaw, from 0 on, that a difference leaves out */
};

static const double SIXTH[ACROSS] = {-1, 6, -15, 20, -15, 6, -1};

/* Weights of seven lines that give difference and slope of a quantity over their yaws. */
typedef struct {
    double difference[ACROSS], slope[ACROSS];
} Stencil;

/* Return the product of the weights of seven lines with their values, for LANES stencils. */
static inline Lanes add_across(const Lanes weights[ACROSS], const Lanes values[ACROSS]) {
    Lanes sum = {0};
    for (int k = 0; k < ACROSS; k++) sum += weights[k] * values[k];
    return sum;
}

static inline Lanes root(Lanes v) {
    double roots[LANES];
    for (int k = 0; k < LANES; k++) roots[k] = sqrt(v[k]);
    return load(roots);
}

/* Write the weights of LANES lines from `first` on, as far as three lines lie to each side: see `weigh_lines`. */
static void weigh_lanes(const Sweep *sweep, int64_t first, Stencil *out) {
    const double *middle = sweep->yaws + sweep->n_beams / 2;
    const int64_t end = sweep->n_lines - REACH, n = end - first < LANES ? end - first : LANES;
    Lanes yaw[ACROSS], x[ACROSS], basis[POWERS][ACROSS], difference[ACROSS], slope[ACROSS] = {{0}};
    for (int64_t lane = 0; lane < LANES; lane++) {
        int64_t i = first + (lane < n ? lane : 0);
        for (int k = 0; k < ACROSS; k++) yaw[k][lane] = middle[(i + k - REACH) * sweep->stride];
    }
    const Lanes turn = yaw[REACH + SLOPE_REACH] - yaw[REACH - SLOPE_REACH];
    for (int k = 0; k < ACROSS; k++) {
        x[k] = (yaw[k] - yaw[REACH]) / turn;
        difference[k] = (Lanes)((LaneBits)((Lanes){0} + SIXTH[k]) | (LaneBits)(turn == 0));    /* all bits: NaN */
    }

    /* take orthonormal polynomials of the yaw out */
    for (int p = 0; p < POWERS; p++) {
        for (int k = 0; k < ACROSS; k++) basis[p][k] = p == 0 ? (Lanes){0} + 1 : x[k] * basis[p - 1][k];
        for (int q = 0; q < p; q++) {
            Lanes onto = add_across(basis[q], basis[p]);
            for (int k = 0; k < ACROSS; k++) basis[p][k] -= onto * basis[q][k];
        }
        Lanes norm = root(add_across(basis[p], basis[p]));
        for (int k = 0; k < ACROSS; k++)
            basis[p][k] = (Lanes)((LaneBits)(basis[p][k] / norm) & (LaneBits)(norm > MIN_NORM));
        Lanes onto = add_across(basis[p], difference);
        for (int k = 0; k < ACROSS; k++) difference[k] -= onto * basis[p][k];
    }
    Lanes scale = root(SQUARES / add_across(difference, difference));
    for (int k = 0; k < ACROSS; k++) difference[k] *= scale;

    /* the slope, independent of the difference */
    slope[REACH + SLOPE_REACH] = 1 / turn, slope[REACH - SLOPE_REACH] = -1 / turn;
    Lanes common = add_across(difference, slope) / SQUARES;
    for (int k = 0; k < ACROSS; k++) slope[k] -= common * difference[k];
    for (int64_t lane = 0; lane < n; lane++)
        for (int k = 0; k < ACROSS; k++)
            out[first + lane].difference[k] = difference[k][lane], out[first + lane].slope[k] = slope[k][lane];
}

/* Write the weights of the lines about each line: of evenly spaced lines the sixth difference, of others what is
 * left of it without low powers of the yaw. The slope is that between two of the lines, less as much of the
 * difference as makes their noises independent. NaN where the lines have not turned; the first and last three
 * lines have none. */
static void weigh_lines(const Sweep *sweep, Stencil *out) {
    for (int64_t i = REACH; i < sweep->n_lines - REACH; i += LANES) weigh_lanes(sweep, i, out);
}
