/* Do two sweeps contradict each other? free_space.py describes the method. */
#pragma once

#include "descend.h"

#define MARGIN 0.02     /* in front by so much is a full violation [m], or by ... */
#define SIGMAS 3.0      /* ... so many standard deviations, whichever is more */
#define HOLE 2          /* nothing returned where nothing did within so many readings */

typedef struct {
    double cost;
    int64_t seen;
} Violations;

/* Sum the violations of a sample at T, and count the surfels of whose ray a reading knows something. */
static Violations sum_violations(const Target *target, const uint8_t *known, const Sample *sample,
                                 const double *T) {
    Violations sum = {0, 0};
    const Projection *p = &target->projection;
    for (int64_t m = 0; m < sample->count; m++) {
        double row[SURFEL];
        for (int c = 0; c < SURFEL; c++) row[c] = sample->columns[c * sample->room + m];
        double x = T[0] * row[X] + T[1] * row[Y] + T[2] * row[Z] + T[3];
        double y = T[4] * row[X] + T[5] * row[Y] + T[6] * row[Z] + T[7];
        double z = T[8] * row[X] + T[9] * row[Y] + T[10] * row[Z] + T[11];
        int32_t at = reading_of(x, y, z, AHEAD, p);
        if ((at < 0 || known[at] == UNSEEN) && p->backwards) at = reading_of(x, y, z, BEHIND, p);
        if (at < 0 || known[at] == UNSEEN) continue;
        sum.seen++;
        if (known[at] == EMPTY) {
            sum.cost += 1;
            continue;
        }
        const double *met = target->rows + SURFEL * target->index[at];
        double e = met[NX] * (x - met[X]) + met[NY] * (y - met[Y]) + met[NZ] * (z - met[Z]);
        double margin = SIGMAS * sqrt(row[VARIANCE] + met[VARIANCE]);
        margin = margin > MARGIN ? margin : MARGIN;
        double share = e / margin;
        if (e >= -margin) sum.cost += share * share < 1 ? share * share : 1;
    }
    return sum;
}

/* Write what each reading of a grid knows of its ray: nothing returned there if nothing did within
 * HOLE readings along lines and beams, since single ones are dropouts. */
static int find_known(const int32_t *index, const uint8_t *valid, int64_t n_lines, int64_t n_beams,
                      uint8_t *known) {
    uint8_t *near = malloc((size_t)(n_lines * n_beams));
    if (!near) return -1;
    for (int64_t i = 0; i < n_lines; i++)
        for (int64_t j = 0; j < n_beams; j++) {
            int64_t low = j > HOLE ? j - HOLE : 0, high = j + HOLE < n_beams ? j + HOLE : n_beams - 1;
            uint8_t any = 0;
            for (int64_t m = low; m <= high; m++) any |= valid[i * n_beams + m];
            near[i * n_beams + j] = any;
        }
    for (int64_t i = 0; i < n_lines; i++) {
        int64_t low = i > HOLE ? i - HOLE : 0, high = i + HOLE < n_lines ? i + HOLE : n_lines - 1;
        for (int64_t j = 0; j < n_beams; j++) {
            uint8_t any = 0;
            for (int64_t k = low; k <= high; k++) any |= near[k * n_beams + j];
            int64_t at = i * n_beams + j;
            known[at] = index[at] >= 0 ? SURFACE : any ? UNSEEN : EMPTY;
        }
    }
    free(near);
    return 0;
}
