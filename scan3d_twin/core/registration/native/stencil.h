/* Difference and slope of a quantity across seven lines of a sweep, evenly spaced or not: scan_noise.py says
 * what for. */
#pragma once

#include "engine.h"
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

/* Return the product of the weights of seven lines with their values. */
static double add_across(const double weights[ACROSS], const double values[ACROSS]) {
    double sum = 0;
    for (int k = 0; k < ACROSS; k++) sum += weights[k] * values[k];
    return sum;
}

/* Return the weights of the lines about line i: of evenly spaced lines the sixth difference, of others what is
 * left of it without low powers of the yaw. The slope is that between two of the lines, less as much of the
 * difference as makes their noises independent. NaN where the lines have not turned. */
static Stencil weigh_lines(const Sweep *sweep, int64_t i) {
    const double *middle = sweep->yaws + sweep->n_beams / 2;
    const int64_t before = (i - SLOPE_REACH) * sweep->stride, after = (i + SLOPE_REACH) * sweep->stride;
    double turn = middle[after] - middle[before], x[ACROSS], basis[POWERS][ACROSS];
    Stencil out = {{0}, {0}};
    for (int k = 0; k < ACROSS; k++) {
        x[k] = (middle[(i + k - REACH) * sweep->stride] - middle[i * sweep->stride]) / turn;
        out.difference[k] = turn == 0 ? NAN : SIXTH[k];
    }

    /* take orthonormal polynomials of the yaw out */
    for (int p = 0; p < POWERS; p++) {
        for (int k = 0; k < ACROSS; k++) basis[p][k] = p == 0 ? 1 : x[k] * basis[p - 1][k];
        for (int q = 0; q < p; q++) {
            double onto = add_across(basis[q], basis[p]);
            for (int k = 0; k < ACROSS; k++) basis[p][k] -= onto * basis[q][k];
        }
        double norm = sqrt(add_across(basis[p], basis[p])), onto = 0;
        for (int k = 0; k < ACROSS; k++) basis[p][k] = norm > MIN_NORM ? basis[p][k] / norm : 0;
        onto = add_across(basis[p], out.difference);
        for (int k = 0; k < ACROSS; k++) out.difference[k] -= onto * basis[p][k];
    }
    double scale = sqrt(SQUARES / add_across(out.difference, out.difference));
    for (int k = 0; k < ACROSS; k++) out.difference[k] *= scale;

    /* the slope, independent of the difference */
    out.slope[REACH + SLOPE_REACH] = 1 / turn, out.slope[REACH - SLOPE_REACH] = -1 / turn;
    double common = add_across(out.difference, out.slope) / SQUARES;
    for (int k = 0; k < ACROSS; k++) out.slope[k] -= common * out.difference[k];
    return out;
}
