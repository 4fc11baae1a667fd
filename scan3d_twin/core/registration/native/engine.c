/* The compiled engine: the functions that Python calls.
 *
 * All of it is compiled once for each level of the processor (build.py), as the names of the exported
 * functions say; the levels differ in speed only, not in a bit of the results: there is no fused
 * multiplication and no sum whose order depends on the width of the registers. */
#include "grids.h"

#define JOIN(name, level) name##_##level
#define NAMED(name, level) JOIN(name, level)
#define EXPORT(name) __attribute__((visibility("default"))) NAMED(name, LEVEL)

/* scan_noise.py */

void EXPORT(range_noise)(const Sweep *sweep, const uint8_t *valid, double *noise) {
    estimate_range_noise(sweep->ranges, valid, sweep->n_lines, sweep->n_beams, sweep->stride, noise);
}

void EXPORT(line_residuals)(const Sweep *sweep, const double *rows, const int32_t *index, double *sums) {
    sum_line_residuals(sweep, rows, index, sums);
}

double EXPORT(yaw_jitter)(const double *sums, int64_t n_lines) {
    return estimate_yaw_jitter(sums, n_lines);
}

/* surfels.py and surfel_grid.py */

int64_t EXPORT(surfels)(const Sweep *sweep, const uint8_t *valid, const uint8_t *keep,
                        const double *noise, const int64_t *half_sizes, int64_t n_windows, double *rows,
                        double *yaws, int32_t *index) {
    Windows windows = {n_windows, (const int64_t (*)[2])half_sizes};
    return fit_surfels(sweep, valid, keep, noise, windows, rows, yaws, index);
}

int64_t EXPORT(survey)(const Sweep *sweep, const int64_t *codes, const uint8_t *keep, Survey *out) {
    return make_survey(sweep, codes, keep, out);
}

void EXPORT(sample)(const int32_t *index, int64_t n_lines, int64_t n_beams, const double *rows,
                    const double *of_rows, Sample *out) {
    take_sample(index, n_lines, n_beams, rows, of_rows, out);
}

int64_t EXPORT(known)(const int32_t *index, const uint8_t *valid, int64_t n_lines, int64_t n_beams,
                      uint8_t *known) {
    return find_known(index, valid, n_lines, n_beams, known);
}

/* edges.py */

int64_t EXPORT(edges)(const Sweep *sweep, const double *rows, const int32_t *index,
                      const uint8_t *valid, double yaw_sigma, double *edges, int64_t most) {
    return search_edges(sweep, rows, index, valid, yaw_sigma, edges, most);
}

void EXPORT(edge_equations)(const double *target, int64_t n_target, const double *source,
                            int64_t n_source, const double *T, double distance, double robust,
                            double *H, double *g) {
    add_edges(target, n_target, source, n_source, T, distance, robust, H, g);
}

/* projection.py */

void EXPORT(cell_centres)(double *centres) {
    write_cell_centres(centres);
}

int64_t EXPORT(table)(const double *angles, int64_t n, double spacing, const double *centres,
                      int32_t *table) {
    return make_table(angles, n, spacing, centres, table);
}

void EXPORT(lookup)(const Projection *projection, const double *points, int64_t n, const uint8_t *seen,
                    int64_t *found) {
    find_readings(projection, points, n, seen, found);
}

/* point_to_plane.py and gauss_newton.py */

int64_t EXPORT(equations)(const Target *target, const Sample *sample, const double *T,
                          const double *nuisances, const Gate *gate, const PairNoise *noise,
                          const Prior *prior, Equations *out) {
    Chunk *scratch = aligned_alloc(64, (sizeof *scratch + 63) / 64 * 64);
    if (!scratch) return -1;
    build_equations(target, sample, T, nuisances, *gate, noise, prior, scratch, out);
    free(scratch);
    return 0;
}

int64_t EXPORT(follow)(const Target *target, const Source *source, const PairNoise *noise,
                       const Prior *prior, const Criteria *criteria, const double *starts, int64_t n,
                       double *ends, Outcome *last) {
    return follow_starts(target, source, noise, prior, criteria, starts, n, ends, last);
}

/* free_space.py */

double EXPORT(violations)(const Target *target, const uint8_t *known, const Sample *sample,
                          const double *T, int64_t *seen) {
    Violations sum = sum_violations(target, known, sample, T);
    *seen = sum.seen;
    return sum.cost;
}

/* algebra.py and pose_prior.py; matrices are dense */

static void widen(const double *dense, int n, double *out) {
    for (int i = 0; i < n; i++) memcpy(out + STATE * i, dense + n * i, sizeof *out * (size_t)n);
}

static void tighten(const double *wide, int n, double *dense) {
    for (int i = 0; i < n; i++) memcpy(dense + n * i, wide + STATE * i, sizeof *dense * (size_t)n);
}

int64_t EXPORT(determined)(const double *H, const double *spurious, const int64_t *entries, int64_t n,
                           double reach, double *kept, double *honest, double *dropped) {
    double wide_H[STATE * STATE] = {0}, wide_spurious[STATE * STATE] = {0};
    Determined found;
    widen(H, (int)n, wide_H);
    widen(spurious, (int)n, wide_spurious);
    find_determined(wide_H, wide_spurious, entries, (int)n, reach, &found);
    tighten(found.kept, (int)n, kept);
    tighten(found.honest, (int)n, honest);
    tighten((const double *)found.dropped, (int)n, dropped);
    return found.n_dropped;
}

void EXPORT(inverse)(const double *information, int64_t n, double least, double *out) {
    double wide[STATE * STATE] = {0}, inverse[STATE * STATE];
    widen(information, (int)n, wide);
    invert(wide, (int)n, least, inverse);
    tighten(inverse, (int)n, out);
}

/* Write the information of the first `pose` of `size` entries when the others are free but for what is
 * known of them: the Schur complement. */
void EXPORT(marginal)(const double *information, int64_t size, int64_t pose, const double *known,
                      double *out) {
    Equations equations = {.size = size};
    Prior prior = {.n_entries = pose, .n_nuisances = size - pose};
    const double nothing[NUISANCES] = {0};
    Reduced reduced;
    widen(information, (int)size, equations.information);
    memcpy(prior.nuisance_information, known, sizeof *known * (size_t)(size - pose));
    eliminate_nuisances(&equations, &prior, nothing, &reduced);
    tighten(reduced.H, (int)pose, out);
}

void EXPORT(displaced)(const double *T, const double *steps, int64_t n, double *out) {
    for (int64_t k = 0; k < n; k++) displace(T, steps + 6 * k, out + 16 * k);
}

void EXPORT(deviation)(const double *T, const double *mean, double *off) {
    find_deviation(T, mean, off);
}

double EXPORT(displacement)(const double *first, const double *second, const double *covariance) {
    double wide[STATE * STATE] = {0};
    widen(covariance, POSE, wide);
    return displacement(first, second, wide);
}

/* clouds.py */

void EXPORT(tree)(const double *points, int64_t n, double *sorted, int32_t *order, uint8_t *axes) {
    Tree tree = {n, sorted, order, axes};
    memcpy(sorted, points, sizeof *sorted * 3 * (size_t)n);
    for (int64_t k = 0; k < n; k++) order[k] = (int32_t)k;
    build_tree(&tree, 0, n);
}

void EXPORT(nearest)(double *sorted, int32_t *order, uint8_t *axes, int64_t n, const double *from,
                     int64_t m, int64_t k, double *squares, int32_t *indices) {
    Tree tree = {n, sorted, order, axes};
    find_nearest(&tree, from, m, k, squares, indices);
}

void EXPORT(neighbourhoods)(double *sorted, int32_t *order, uint8_t *axes, int64_t n, int64_t k,
                            double *centroids, double *normals, double *variances) {
    Tree tree = {n, sorted, order, axes};
    fit_neighbourhoods(&tree, k, centroids, normals, variances);
}

int64_t EXPORT(near)(const double *points, int64_t n, const double *places, int64_t m, double within,
                     uint8_t *near) {
    return find_near(points, n, places, m, within, near);
}

/* mixed_pixels.py, gaps.py, readings.py, costmap.py and model.py */

void EXPORT(mixed)(const double *ranges, const double *elevations, const double *yaws, int64_t n_lines,
                   int64_t n_beams, double noise, double steepest, uint8_t *mixed) {
    mark_mixed(ranges, elevations, yaws, n_lines, n_beams, noise, steepest, mixed);
}

void EXPORT(gaps)(double *ranges, const double *elevations, const double *yaws, int64_t n_lines,
                  int64_t n_beams, double max_angle, double depth_edge) {
    fill_gaps(ranges, elevations, yaws, n_lines, n_beams, max_angle, depth_edge);
}

void EXPORT(placed)(const int64_t *index, int64_t n, int64_t n_beams, const double *ranges,
                    const double *c, const double *s, const double *rays, const double *lever,
                    double *points, int64_t *lines, int64_t *beams, double *distance) {
    place_readings(index, n, n_beams, ranges, c, s, rays, lever, points, lines, beams, distance);
}

int64_t EXPORT(free_reach)(const int64_t *lines, const double *distance, const uint8_t *kinds, int64_t n,
                           int64_t n_lines, double start, double most, double margin, double *reach) {
    double *scratch = malloc(sizeof *scratch * (size_t)(n + 1));
    if (!scratch) return -1;
    find_free_reach(lines, distance, kinds, n, n_lines, start, most, margin, scratch, reach);
    free(scratch);
    return 0;
}

void EXPORT(neighbours)(const double *ranges, const double *yaws, const double *elevations,
                        int64_t n_lines, int64_t n_beams, const int64_t *lines, const int64_t *beams,
                        int64_t n, double noise, double steepest, int64_t *counts) {
    count_neighbours(ranges, yaws, elevations, n_lines, n_beams, lines, beams, n, noise, steepest, counts);
}

/* grids.py and target.py */

int64_t EXPORT(dilated)(const uint8_t *grid, int64_t nx, int64_t ny, const int64_t *disc, int64_t n_rows,
                        uint8_t *out) {
    return dilate(grid, nx, ny, disc, n_rows, out);
}

int64_t EXPORT(labels)(const uint8_t *grid, int64_t nx, int64_t ny, int32_t *labels) {
    return label(grid, nx, ny, labels);
}

int64_t EXPORT(pieces)(const double *ranges, int64_t n_lines, int64_t n_beams, const int64_t *lines,
                       const int64_t *beams, int64_t n, double most, int64_t *sizes) {
    return measure_pieces(ranges, n_lines, n_beams, lines, beams, n, most, sizes);
}

/* Sizes of the values that cross the border, in the order of engine.h: both sides must agree. */

void EXPORT(sizes)(int64_t *sizes) {
    const int64_t own[] = {sizeof(Sweep), sizeof(Survey), sizeof(Projection), sizeof(Target),
                           sizeof(Sample), sizeof(Source), sizeof(PairNoise), sizeof(Prior),
                           sizeof(Criteria), sizeof(Gate), sizeof(Equations), sizeof(Outcome)};
    memcpy(sizes, own, sizeof own);
}
