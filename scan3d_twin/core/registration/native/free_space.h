/* Free-space violations between two sweeps: free_space.py describes the method. */
#pragma once

#include "descend.h"

/* A surfel this far in front of the other surface counts as a full violation, whichever is larger: */
#define VIOLATION_DISTANCE 0.02 /* [m] */
#define VIOLATION_SIGMAS 3.0    /* standard deviations */

#define MAX_DROPOUT 2           /* a ray without return is empty if no reading this near has one */

typedef struct {
    double cost;
    int64_t seen;
} Violations;

/* Sum the violations of a sample at T, and count its surfels on rays that are not unknown. An empty ray knows
 * nothing of what is out of the lidar's range. */
static Violations sum_violations(const Target *target, const uint8_t *known, double max_range,
                                 const Sample *sample, const double *T) {
    Violations sum = {0, 0};
    const Projection *p = &target->projection;
    const double *lidar = p->mount + 5;
    const double reach = MAX_RANGE_SHARE * max_range - sqrt(lidar[0] * lidar[0] + lidar[1] * lidar[1]);
    for (int64_t m = 0; m < sample->count; m++) {
        const double *row = sample->rows + SURFEL * sample->chosen[m];
        double x = T[0] * row[X] + T[1] * row[Y] + T[2] * row[Z] + T[3];
        double y = T[4] * row[X] + T[5] * row[Y] + T[6] * row[Z] + T[7];
        double z = T[8] * row[X] + T[9] * row[Y] + T[10] * row[Z] + T[11];
        int32_t at = reading_of(x, y, z, AHEAD, p);
        if ((at < 0 || known[at] == UNKNOWN_RAY) && p->backwards) at = reading_of(x, y, z, BEHIND, p);
        if (at < 0 || known[at] == UNKNOWN_RAY) continue;

        /* score against the ray */
        if (known[at] == EMPTY_RAY) {
            double up = z - lidar[2];
            int within = x * x + y * y + up * up < reach * reach;
            sum.seen += within, sum.cost += within;
            continue;
        }
        sum.seen++;
        const double *met = target->rows + SURFEL * target->index[at];
        double e = met[NX] * (x - met[X]) + met[NY] * (y - met[Y]) + met[NZ] * (z - met[Z]);
        double margin = VIOLATION_SIGMAS * sqrt(row[VARIANCE] + met[VARIANCE]);
        margin = margin > VIOLATION_DISTANCE ? margin : VIOLATION_DISTANCE;
        double share = e / margin;
        if (e >= -margin) sum.cost += share * share < 1 ? share * share : 1;
    }
    return sum;
}

/* Return whether a point lies in front of a surfel by the distance of a full violation; `variance` is the point's
 * own. */
static int is_in_front(const double *met, const double point[3], double variance) {
    double e = met[NX] * (point[0] - met[X]) + met[NY] * (point[1] - met[Y]) + met[NZ] * (point[2] - met[Z]);
    double margin = VIOLATION_SIGMAS * sqrt(variance + met[VARIANCE]);
    return e >= (margin > VIOLATION_DISTANCE ? margin : VIOLATION_DISTANCE);
}

/* Return whether a point whose ray met the surfel `row` lies in front of what the lines before and after met, too.
 * The space between two lines was not seen: what stands beside the last ray that passes an edge, or the last line
 * of all, contradicts nothing. */
static int is_between_free_rays(const Target *target, int32_t row, const double point[3], double variance) {
    const Projection *p = &target->projection;
    int32_t at = reading_of(point[0], point[1], point[2], AHEAD, p);
    if (at < 0 || target->index[at] != row) at = reading_of(point[0], point[1], point[2], BEHIND, p);
    if (at < p->n_beams || at >= (p->n_lines - 1) * p->n_beams) return 0;
    int32_t before = target->index[at - p->n_beams], after = target->index[at + p->n_beams];
    return before >= 0 && after >= 0 && is_in_front(target->rows + SURFEL * before, point, variance)
        && is_in_front(target->rows + SURFEL * after, point, variance);
}

/* Return the share of a sample's surfels at T in front of the target's surface, by the distance of a full
 * violation, of those on whose rays it met one. */
static double find_share_in_front(const Target *target, const Sample *sample, const double *T, Chunk *w) {
    const double t0 = T[0], t1 = T[1], t2 = T[2], t3 = T[3], t4 = T[4], t5 = T[5];
    const double t6 = T[6], t7 = T[7], t8 = T[8], t9 = T[9], t10 = T[10], t11 = T[11];
    const double least = VIOLATION_DISTANCE * VIOLATION_DISTANCE, sigmas = VIOLATION_SIGMAS * VIOLATION_SIGMAS;
    int64_t seen = 0, in_front = 0;
    uint8_t candidates[CHUNK];
    for (int64_t first = 0; first < sample->count; first += CHUNK) {
        int64_t n = sample->count - first < CHUNK ? sample->count - first : CHUNK;
        gather_pairs(target, sample, first, n, T, w);
        for (int64_t k = 0; k < n; k++) {
            double px = w->source[X][k], py = w->source[Y][k], pz = w->source[Z][k];
            double ux = t0 * px + t1 * py + t2 * pz + t3 - w->target[X][k];
            double uy = t4 * px + t5 * py + t6 * pz + t7 - w->target[Y][k];
            double uz = t8 * px + t9 * py + t10 * pz + t11 - w->target[Z][k];
            double e = w->target[NX][k] * ux + w->target[NY][k] * uy + w->target[NZ][k] * uz;
            double margin = sigmas * (w->source[VARIANCE][k] + w->target[VARIANCE][k]);
            margin = margin > least ? margin : least;
            int met = w->row[k] >= 0;
            seen += met;
            candidates[k] = (uint8_t)(met & (e > 0) & (e * e >= margin));
        }

        /* few are left to be looked at by themselves */
        for (int64_t k = 0; k < n; k++) {
            if (!candidates[k]) continue;
            double px = w->source[X][k], py = w->source[Y][k], pz = w->source[Z][k];
            const double point[3] = {t0 * px + t1 * py + t2 * pz + t3, t4 * px + t5 * py + t6 * pz + t7,
                                     t8 * px + t9 * py + t10 * pz + t11};
            in_front += is_between_free_rays(target, w->row[k], point, w->source[VARIANCE][k]);
        }
    }
    return seen > 0 ? (double)in_front / (double)seen : 0;
}

/* Write the inverse of a rigid transform; the last row is not read. */
static void invert_rigid(const double *T, double *back) {
    for (int i = 0; i < 3; i++) {
        back[4 * i + 3] = 0;
        for (int j = 0; j < 3; j++) {
            back[4 * i + j] = T[4 * j + i];
            back[4 * i + 3] -= T[4 * j + i] * T[4 * j + 3];
        }
    }
}

/* Return the larger share of either sweep's sample in front of the other's surface, or -1 if memory runs
 * out. */
static double find_contradicted_share(const Target *target, const Sample *of_target, const Target *source,
                                      const Sample *of_source, const double *T) {
    Chunk *scratch = aligned_alloc(64, (sizeof *scratch + 63) / 64 * 64);
    double back[12];
    if (!scratch) return -1;
    invert_rigid(T, back);
    double share = find_share_in_front(target, of_source, T, scratch);
    double other = find_share_in_front(source, of_target, back, scratch);
    free(scratch);
    return share > other ? share : other;
}

/* Classify the ray of each reading: on a surface, empty, or unknown. A ray is empty only if none of the
 * readings within MAX_DROPOUT lines and beams returned, since single readings drop out. Return 0, or -1
 * if memory runs out. */
static int classify_rays(const int32_t *index, const uint8_t *valid, int64_t n_lines, int64_t n_beams,
                         uint8_t *known) {
    uint8_t *near = malloc((size_t)(n_lines * n_beams));
    if (!near) return -1;

    /* valid readings near by along the line */
    for (int64_t i = 0; i < n_lines; i++)
        for (int64_t j = 0; j < n_beams; j++) {
            int64_t low = j > MAX_DROPOUT ? j - MAX_DROPOUT : 0;
            int64_t high = j + MAX_DROPOUT < n_beams ? j + MAX_DROPOUT : n_beams - 1;
            uint8_t any = 0;
            for (int64_t m = low; m <= high; m++) any |= valid[i * n_beams + m];
            near[i * n_beams + j] = any;
        }

    /* and across the lines */
    for (int64_t i = 0; i < n_lines; i++) {
        int64_t low = i > MAX_DROPOUT ? i - MAX_DROPOUT : 0;
        int64_t high = i + MAX_DROPOUT < n_lines ? i + MAX_DROPOUT : n_lines - 1;
        for (int64_t j = 0; j < n_beams; j++) {
            uint8_t any = 0;
            for (int64_t k = low; k <= high; k++) any |= near[k * n_beams + j];
            int64_t at = i * n_beams + j;
            known[at] = index[at] >= 0 ? SURFACE_RAY : any ? UNKNOWN_RAY : EMPTY_RAY;
        }
    }
    free(near);
    return 0;
}
