/* Vertical edges at which surfaces end in view: edges.py describes the method. */
#pragma once

#include "survey.h"

#define JUMP 0.10           /* least step in range at an edge [m] */
#define MIN_HEIGHT 0.05     /* least height of a run of jumps [m] */
#define MIN_EDGE_COSINE 0.35    /* a surface seen flatter (70 deg) may be turning away */
#define MIN_UPRIGHT 0.9     /* least length of a normal in the top view (26 deg of lean) */
#define MOST_SPREAD 0.01    /* a run that scatters more in the top view is no vertical edge [m] */
#define OFF_PLANE 0.03      /* the last reading lies on the plane that ends [m]: 3 sigma */

enum {
    MIN_BEAMS = 8,          /* in a run of jumps */
    NOTHING = 3,            /* lines without return that count as nothing there */
    INWARDS = 2,            /* lines from the edge to the surfel that carries it */
};

typedef struct {
    int64_t low, high;
} Beams;

/* First beam of a line that has a surfel, and the end of them. */
static Beams carrying_beams(const int32_t *index, int64_t n_beams) {
    Beams b = {0, n_beams};
    while (b.low < n_beams && index[b.low] < 0) b.low++;
    while (b.high > b.low && index[b.high - 1] < 0) b.high--;
    return b;
}

/* Mark at which beams the surface on line `near` ends towards `side`; return how many there are. */
static int64_t mark_jumps(const Sweep *sweep, const int32_t *index, const uint8_t *valid,
                          int64_t near, int64_t side, Beams beams, uint8_t *restrict jumps) {
    const int64_t step = side * sweep->stride, at = near * sweep->stride;
    const int64_t last = near + NOTHING * side;
    const int ends = last < 0 || last >= sweep->n_lines;    /* too few lines to say so */
    const double *here = sweep->ranges + at, *next = here + step;
    const uint8_t *valid_here = valid + at, *valid_next = valid_here + step;
    const int32_t *carried = index + at - INWARDS * step;
    int32_t n = 0;
    for (int64_t j = beams.low; j < beams.high; j++) {
        jumps[j] = valid_here[j] & (carried[j] >= 0)
                 & ((valid_next[j] & (next[j] - here[j] > JUMP)) | (!valid_next[j] & !ends));
        n += jumps[j];
    }
    /* nothing there only where the lines after the next saw nothing, either */
    for (int64_t k = 2; k <= NOTHING && n > 0 && !ends; k++) {
        const uint8_t *beyond = valid_here + k * step;
        n = 0;
        for (int64_t j = beams.low; j < beams.high; j++) {
            jumps[j] &= valid_next[j] | !beyond[j];
            n += jumps[j];
        }
    }
    return n;
}

/* Write x, y of the edge and z of the surfel (3) at the upright beams of a run; return how many. */
static int64_t place_run(const Sweep *sweep, const double *rows, const int32_t *index, int64_t near,
                         int64_t side, Beams run, double (*places)[3]) {
    const int32_t *carried = index + (near - INWARDS * side) * sweep->stride;
    const double *rays = sweep->rays + near * sweep->ray_stride;
    int64_t n = 0;
    for (int64_t j = run.low; j < run.high; j++) {
        int64_t at = near * sweep->stride + j;
        double r = sweep->ranges[at];
        Turn turn = turn_by(sweep->yaws[at]);
        double ahead = sweep->lever[0] + r * rays[3 * j], left = sweep->lever[1] + r * rays[3 * j + 1];
        double x = turn.c * ahead - turn.s * left, y = turn.s * ahead + turn.c * left;
        double z = sweep->lever[2] + r * rays[3 * j + 2];
        const double *q = rows + SURFEL * carried[j];
        double off = fabs(q[NX] * (x - q[X]) + q[NY] * (y - q[Y]) + q[NZ] * (z - q[Z]));
        Turn middle = turn_by((sweep->yaws[at] + sweep->yaws[at + side * sweep->stride]) / 2);
        double facing = q[NX] * middle.c + q[NY] * middle.s;
        double upright = sqrt(q[NX] * q[NX] + q[NY] * q[NY]);
        if (-facing <= MIN_EDGE_COSINE || upright <= MIN_UPRIGHT || off >= OFF_PLANE) continue;
        double rho = (q[NX] * q[X] + q[NY] * q[Y]) / facing;
        places[n][0] = rho * middle.c, places[n][1] = rho * middle.s, places[n++][2] = q[Z];
    }
    return n;
}

/* Write the edge through `places`; return 1, or 0 if they are none. */
static int64_t make_edge(double (*places)[3], int64_t n, double spread, int64_t side, double *edge) {
    if (n < MIN_BEAMS) return 0;
    double low = places[0][2], high = low, x = 0, y = 0, scatter = 0;
    for (int64_t k = 0; k < n; k++) {
        low = places[k][2] < low ? places[k][2] : low, high = places[k][2] > high ? places[k][2] : high;
        x += places[k][0] / (double)n, y += places[k][1] / (double)n;
    }
    if (high - low < MIN_HEIGHT) return 0;
    for (int64_t k = 0; k < n; k++) {
        double dx = places[k][0] - x, dy = places[k][1] - y;
        scatter += dx * dx + dy * dy;
    }
    if (sqrt(scatter / (double)n) > MOST_SPREAD) return 0;
    double distance = sqrt(x * x + y * y);
    edge[PLACE_X] = x, edge[PLACE_Y] = y;
    edge[ACROSS_X] = -y / distance, edge[ACROSS_Y] = x / distance;
    edge[EDGE_VARIANCE] = distance * distance * spread, edge[SIDE] = (double)side;
    edge[LOW] = low, edge[HIGH] = high;
    return 1;
}

/* Write the edges of a sweep, at most `most`; return how many there are, or -1 without memory. */
static int64_t search_edges(const Sweep *sweep, const double *rows, const int32_t *index,
                            const uint8_t *valid, double yaw_sigma, double *edges, int64_t most) {
    int64_t n_lines = sweep->n_lines, n_beams = sweep->n_beams, count = 0;
    uint8_t *jumps = malloc((size_t)n_beams);
    double (*places)[3] = malloc(sizeof *places * (size_t)n_beams);
    Beams *carrying = malloc(sizeof *carrying * (size_t)n_lines);
    if (!jumps || !places || !carrying) {
        count = -1;
        goto done;
    }
    double spacing = 0;
    for (int64_t j = 0; j < n_beams; j++)
        spacing += fabs(sweep->yaws[sweep->stride + j] - sweep->yaws[j]) / (double)n_beams;
    double variance = spacing * spacing / 12 + yaw_sigma * yaw_sigma;
    for (int64_t i = 0; i < n_lines; i++)
        carrying[i] = carrying_beams(index + i * sweep->stride, n_beams);

    for (int64_t side = 1; side >= -1; side -= 2) {
        for (int64_t pair = 0; pair + 1 < n_lines; pair++) {
            int64_t near = side > 0 ? pair : pair + 1, inner = near - INWARDS * side;
            if (inner < 0 || inner >= n_lines) continue;
            Beams beams = carrying[inner];
            if (beams.high - beams.low < MIN_BEAMS) continue;
            if (mark_jumps(sweep, index, valid, near, side, beams, jumps) < MIN_BEAMS) continue;
            for (int64_t j = beams.low, first = -1; j <= beams.high; j++) {
                if (j < beams.high && jumps[j]) {
                    first = first < 0 ? j : first;
                    continue;
                }
                if (first >= 0 && j - first >= MIN_BEAMS && count < most) {
                    int64_t n = place_run(sweep, rows, index, near, side, (Beams){first, j}, places);
                    count += make_edge(places, n, variance, side, edges + EDGE * count);
                }
                first = -1;
            }
        }
    }
done:
    free(jumps);
    free(places);
    free(carrying);
    return count;
}
