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

/* Sum the violations of a sample at T, and count its surfels on rays that are not unknown. */
static Violations sum_violations(const Target *target, const uint8_t *known, const Sample *sample,
                                 const double *T) {
    Violations sum = {0, 0};
    const Projection *p = &target->projection;
    for (int64_t m = 0; m < sample->count; m++) {
        const double *row = sample->rows + SURFEL * sample->chosen[m];
        double x = T[0] * row[X] + T[1] * row[Y] + T[2] * row[Z] + T[3];
        double y = T[4] * row[X] + T[5] * row[Y] + T[6] * row[Z] + T[7];
        double z = T[8] * row[X] + T[9] * row[Y] + T[10] * row[Z] + T[11];
        int32_t at = reading_of(x, y, z, AHEAD, p);
        if ((at < 0 || known[at] == UNKNOWN_RAY) && p->backwards) at = reading_of(x, y, z, BEHIND, p);
        if (at < 0 || known[at] == UNKNOWN_RAY) continue;

        /* score against the ray */
        sum.seen++;
        if (known[at] == EMPTY_RAY) {
            sum.cost += 1;
            continue;
        }
        const double *met = target->rows + SURFEL * target->index[at];
        double e = met[NX] * (x - met[X]) + met[NY] * (y - met[Y]) + met[NZ] * (z - met[Z]);
        double margin = VIOLATION_SIGMAS * sqrt(row[VARIANCE] + met[VARIANCE]);
        margin = margin > VIOLATION_DISTANCE ? margin : VIOLATION_DISTANCE;
        double share = e / margin;
        if (e >= -margin) sum.cost += share * share < 1 ? share * share : 1;
    }
    return sum;
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
