/* Vertical edges at which surfaces end in view: edges.py describes the method. */
#pragma once

#include "extract_surfels.h"

#define MIN_RANGE_STEP 0.10     /* at an edge [m] */
#define MIN_HEIGHT 0.05         /* of an edge [m] */
#define MIN_EDGE_COSINE 0.35    /* of incidence (70 deg): a surface seen flatter may be a silhouette */
#define MIN_UPRIGHT 0.9         /* length of a normal in the top view (26 deg of lean) */
#define MAX_EDGE_SPREAD 0.01    /* scatter of a vertical edge in the top view [m] */
#define MAX_UNEVENNESS 0.25     /* of the spacing of lines, up to which they count as evenly spaced */
#define MAX_BEND 0.12           /* tangent of the angle between normals FLAT_LINES apart on a flat face (7 deg) */
#define MAX_PLANE_DISTANCE 0.03 /* of the last reading from the plane that ends [m]: 3 sigma */
#define MAX_RANGE_SHARE 0.95    /* of the longest range: a surface that goes on beyond may be out of reach */

enum {
    MIN_BEAMS = 8,              /* of an edge, next to each other */
    EMPTY_LINES = 3,            /* lines without return that count as empty space */
    SURFEL_OFFSET = 2,          /* lines from the edge to the surfel of its face */
    FLAT_LINES = 4,             /* lines from there to one whose normals agree on a flat face */
};

/* Beams of a line from `low` on, before `high`. */
typedef struct {
    int64_t low, high;
} Beams;

/* Return the beams of a line from its first surfel to its last, without branches. */
static Beams find_surfel_beams(const int32_t *index, int64_t n_beams) {
    int32_t n = (int32_t)n_beams, low = n, high = 0;
    for (int32_t j = 0; j < n; j++) {
        int32_t from = index[j] >= 0 ? j : n, to = index[j] >= 0 ? j + 1 : 0;
        low = from < low ? from : low, high = to > high ? to : high;
    }
    return (Beams){low, high};
}

/* Mark the beams at which the surface on line `near` ends towards `side`; return their number. */
static int64_t mark_jumps(const Sweep *sweep, const int32_t *index, const uint8_t *valid,
                          int64_t near, int64_t side, Beams beams, uint8_t *restrict jumps) {
    const int64_t step = side * sweep->stride, at = near * sweep->stride;
    const int64_t last = near + EMPTY_LINES * side;
    const int ends = last < 0 || last >= sweep->n_lines;    /* too few lines to know it empty */
    const double *here = sweep->ranges + at, *next = here + step;
    const uint8_t *valid_here = valid + at, *valid_next = valid_here + step;
    const int32_t *carried = index + at - SURFEL_OFFSET * step;
    int32_t n = 0;

    /* next line farther, or without return */
    for (int64_t j = beams.low; j < beams.high; j++) {
        jumps[j] = valid_here[j] & (carried[j] >= 0)
                 & ((valid_next[j] & (next[j] - here[j] > MIN_RANGE_STEP)) | (!valid_next[j] & !ends));
        n += jumps[j];
    }

    /* empty only if the lines beyond are */
    for (int64_t k = 2; k <= EMPTY_LINES && n > 0 && !ends; k++) {
        const uint8_t *beyond = valid_here + k * step;
        n = 0;
        for (int64_t j = beams.low; j < beams.high; j++) {
            jumps[j] &= valid_next[j] | !beyond[j];
            n += jumps[j];
        }
    }
    return n;
}

/* Return whether the surface of a run is flat towards its edge: whether its normals next to the edge agree
 * with those FLAT_LINES farther in. A round body's do not, and what it ends at is its outline, which
 * wanders with the viewpoint. What is too narrow to tell is not flat. */
static int is_flat_run(const Sweep *sweep, const double *rows, const int32_t *index, int64_t near,
                       int64_t side, Beams run) {
    int64_t next = near - SURFEL_OFFSET * side, inner = next - FLAT_LINES * side, n = 0;
    if (inner < 0 || inner >= sweep->n_lines) return 0;
    double here[2] = {0}, farther[2] = {0};
    for (int64_t j = run.low; j < run.high; j++) {
        int32_t at = index[next * sweep->stride + j], in = index[inner * sweep->stride + j];
        if (at < 0 || in < 0) continue;
        n++;
        for (int m = 0; m < 2; m++) {
            here[m] += rows[SURFEL * at + NX + m];
            farther[m] += rows[SURFEL * in + NX + m];
        }
    }
    double along = here[0] * farther[0] + here[1] * farther[1];
    double across = here[0] * farther[1] - here[1] * farther[0];
    return 2 * n >= run.high - run.low && fabs(across) < MAX_BEND * along;
}

/* Return whether the plane of a surfel `q` goes on at the reading `next` beyond the edge: the reading lies on it,
 * or there is none because the plane is out of reach there. A wall seen at a grazing angle steps by more than
 * MIN_RANGE_STEP from one line to the next, and the one at which the lidar's range ends is another one from
 * each viewpoint. */
static int goes_on(const Sweep *sweep, const double *q, int64_t next, int is_valid) {
    const double *ray = sweep->rays + next / sweep->stride * sweep->ray_stride + 3 * (next % sweep->stride);
    Turn turn = turn_by(sweep->yaws[next]);
    const double ahead = sweep->lever[0], left = sweep->lever[1];
    double eye[3] = {turn.c * ahead - turn.s * left, turn.s * ahead + turn.c * left, sweep->lever[2]};
    double d[3] = {turn.c * ray[0] - turn.s * ray[1], turn.s * ray[0] + turn.c * ray[1], ray[2]};
    double along = q[NX] * d[0] + q[NY] * d[1] + q[NZ] * d[2], height = 0;
    for (int i = 0; i < 3; i++) height += q[NX + i] * (q[X + i] - eye[i]);

    /* seen from behind or in parallel, it goes on for ever */
    if (along >= 0 || height / along > MAX_RANGE_SHARE * sweep->max_range) return 1;
    return is_valid && fabs(sweep->ranges[next] * along - height) < MAX_PLANE_DISTANCE;
}

/* Write x, y of the edge and z of the surfel (3) at the upright beams of a run; return their number. */
static int64_t place_run(const Sweep *sweep, const double *rows, const int32_t *index, const uint8_t *valid,
                         int64_t near, int64_t side, Beams run, double (*places)[3]) {
    const int32_t *carried = index + (near - SURFEL_OFFSET * side) * sweep->stride;
    const double *rays = sweep->rays + near * sweep->ray_stride;
    int64_t n = 0;
    for (int64_t j = run.low; j < run.high; j++) {
        int64_t at = near * sweep->stride + j;
        double r = sweep->ranges[at];
        Turn turn = turn_by(sweep->yaws[at]);
        double ahead = sweep->lever[0] + r * rays[3 * j], left = sweep->lever[1] + r * rays[3 * j + 1];
        double x = turn.c * ahead - turn.s * left, y = turn.s * ahead + turn.c * left;
        double z = sweep->lever[2] + r * rays[3 * j + 2];

        /* surfel of the face that ends here */
        const double *q = rows + SURFEL * carried[j];
        double off = fabs(q[NX] * (x - q[X]) + q[NY] * (y - q[Y]) + q[NZ] * (z - q[Z]));
        Turn middle = turn_by((sweep->yaws[at] + sweep->yaws[at + side * sweep->stride]) / 2);
        double facing = q[NX] * middle.c + q[NY] * middle.s;
        double upright = sqrt(q[NX] * q[NX] + q[NY] * q[NY]);
        int64_t next = at + side * sweep->stride;
        if (goes_on(sweep, q, next, valid[next])) continue;
        if (-facing <= MIN_EDGE_COSINE || upright <= MIN_UPRIGHT || off >= MAX_PLANE_DISTANCE) continue;

        /* its plane, halfway to the next line */
        double rho = (q[NX] * q[X] + q[NY] * q[Y]) / facing;
        places[n][0] = rho * middle.c, places[n][1] = rho * middle.s, places[n++][2] = q[Z];
    }
    return n;
}

/* Write the edge through `places`; return 1, or 0 if they form no vertical edge. */
static int64_t make_edge(double (*places)[3], int64_t n, double spread, int64_t side, double *edge) {
    if (n < MIN_BEAMS) return 0;

    /* middle, height and scatter */
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
    if (sqrt(scatter / (double)n) > MAX_EDGE_SPREAD) return 0;
    double distance = sqrt(x * x + y * y);
    edge[PLACE_X] = x, edge[PLACE_Y] = y;
    edge[ACROSS_X] = -y / distance, edge[ACROSS_Y] = x / distance;
    edge[EDGE_VARIANCE] = distance * distance * spread, edge[SIDE] = (double)side;
    edge[LOW] = low, edge[HIGH] = high;
    return 1;
}

/* Return the angle between the lines beside an edge: `usual`, unless they are unevenly spaced. Lines that see
 * the same place twice leave the edge as uncertain as half the mean spacing. */
static double spacing_at(const Sweep *sweep, int64_t pair, int64_t beam, double usual) {
    const double *yaws = sweep->yaws + beam, *here = yaws + pair * sweep->stride;
    double step = fabs(here[sweep->stride] - here[0]);
    if (fabs(step - usual) <= MAX_UNEVENNESS * usual) return usual;
    double turn = fabs(yaws[(sweep->n_lines - 1) * sweep->stride] - yaws[0]);
    double least = turn / (double)(2 * (sweep->n_lines - 1));
    return step > least ? step : least;
}

/* Write at most `most` edges of a sweep; return their number, or -1 if memory runs out. */
static int64_t find_edges(const Sweep *sweep, const double *rows, const int32_t *index,
                          const uint8_t *valid, double yaw_sigma, double *edges, int64_t most) {
    int64_t n_lines = sweep->n_lines, n_beams = sweep->n_beams, count = 0;
    uint8_t *jumps = malloc((size_t)n_beams);
    double (*places)[3] = malloc(sizeof *places * (size_t)n_beams);
    Beams *with_surfels = malloc(sizeof *with_surfels * (size_t)n_lines);
    if (!jumps || !places || !with_surfels) {
        count = -1;
        goto done;
    }

    /* usual spacing of lines */
    double spacing = 0;
    for (int64_t j = 0; j < n_beams; j++)
        spacing += fabs(sweep->yaws[sweep->stride + j] - sweep->yaws[j]) / (double)n_beams;
    for (int64_t i = 0; i < n_lines; i++)
        with_surfels[i] = find_surfel_beams(index + i * sweep->stride, n_beams);

    /* runs of beams that end on a line, to the right and to the left */
    for (int64_t side = 1; side >= -1; side -= 2) {
        for (int64_t pair = 0; pair + 1 < n_lines; pair++) {
            int64_t near = side > 0 ? pair : pair + 1, inner = near - SURFEL_OFFSET * side;
            if (inner < 0 || inner >= n_lines) continue;
            Beams beams = with_surfels[inner];
            if (beams.high - beams.low < MIN_BEAMS) continue;
            if (mark_jumps(sweep, index, valid, near, side, beams, jumps) < MIN_BEAMS) continue;
            for (int64_t j = beams.low, first = -1; j <= beams.high; j++) {
                if (j < beams.high && jumps[j]) {
                    first = first < 0 ? j : first;
                    continue;
                }
                Beams run = {first, j};
                if (first >= 0 && j - first >= MIN_BEAMS && count < most
                    && is_flat_run(sweep, rows, index, near, side, run)) {
                    int64_t n = place_run(sweep, rows, index, valid, near, side, run, places);
                    double step = spacing_at(sweep, pair, (first + j) / 2, spacing);
                    double variance = step * step / 12 + yaw_sigma * yaw_sigma;
                    count += make_edge(places, n, variance, side, edges + EDGE * count);
                }
                first = -1;
            }
        }
    }
done:
    free(jumps);
    free(places);
    free(with_surfels);
    return count;
}
