/* The compiled engine: the functions that Python calls.
 *
 * Everything is compiled once for each processor level (hatch_build.py), which is the suffix of the
 * exported names. The levels differ in speed alone: without fused multiply-add, and with sums whose order
 * does not depend on the register width, the results are the same to the last bit. */
#include "windows.h"

#define JOIN(name, level) name##_##level
#define AT_LEVEL(name, level) JOIN(name, level)
#define EXPORT(name) __attribute__((visibility("default"))) AT_LEVEL(name, LEVEL)

/* scan_noise.py */

int64_t EXPORT(estimate_noise)(const Sweep *sweep, const uint8_t *valid, double *noise) {
    return estimate_noise(sweep, valid, noise);
}

/* surfels/extraction.py and surfels/grid.py */

int64_t EXPORT(fit_surfels)(const Sweep *sweep, const uint8_t *valid, const uint8_t *keep,
                            const double *noise, const int64_t *half_sizes, int64_t n_windows,
                            double *rows, double *yaws, int32_t *index) {
    Windows windows = {n_windows, (const int64_t (*)[2])half_sizes};
    return fit_surfels(sweep, valid, keep, noise, windows, rows, yaws, index);
}

int64_t EXPORT(mark_valid)(const double *ranges, const int64_t *codes, int64_t n, uint8_t *valid) {
    return mark_valid(ranges, codes, n, valid);
}

int64_t EXPORT(extract_surfels)(const Sweep *sweep, const uint8_t *wanted, ScanSurfels *out) {
    return extract_surfels(sweep, wanted, out);
}

void EXPORT(sample_surfels)(const int32_t *index, int64_t n_lines, int64_t n_beams, Sample *out) {
    sample_surfels(index, n_lines, n_beams, out);
}

int64_t EXPORT(classify_rays)(const int32_t *index, const uint8_t *valid, int64_t n_lines,
                              int64_t n_beams, uint8_t *known) {
    return classify_rays(index, valid, n_lines, n_beams, known);
}

/* edges.py */

int64_t EXPORT(find_edges)(const Sweep *sweep, const double *rows, const int32_t *index,
                           const uint8_t *valid, double yaw_sigma, double *edges, int64_t most) {
    return find_edges(sweep, rows, index, valid, yaw_sigma, edges, most);
}

void EXPORT(linearise_edges)(const double *target, int64_t n_target, const double *source,
                             int64_t n_source, const double *T, double distance, double robust,
                             double *H, double *g) {
    linearise_edges(target, n_target, source, n_source, T, distance, robust, H, g);
}

/* projection.py */

void EXPORT(write_cell_centres)(double *centres) {
    write_cell_centres(centres);
}

void EXPORT(locate_angles)(const double *angles, int64_t n, double *cells) {
    locate_angles(angles, n, cells);
}

int64_t EXPORT(tabulate_nearest)(const double *angles, int64_t n, double spacing, const double *centres,
                                 int32_t *table) {
    return tabulate_nearest(angles, n, spacing, centres, table);
}

void EXPORT(find_readings)(const Projection *projection, const double *points, int64_t n,
                           const uint8_t *seen, int64_t *found) {
    find_readings(projection, points, n, seen, found);
}

/* point_to_plane.py and gauss_newton.py */

int64_t EXPORT(build_equations)(const Target *target, const Sample *sample, const double *T,
                                const double *nuisances, const Gate *gate, const PairNoise *noise,
                                const Prior *prior, Equations *out) {
    Chunk *scratch = aligned_alloc(64, (sizeof *scratch + 63) / 64 * 64);
    if (!scratch) return -1;
    build_equations(target, sample, T, nuisances, *gate, noise, prior, scratch, out);
    free(scratch);
    return 0;
}

int64_t EXPORT(follow_starts)(const Target *target, const Source *source, const PairNoise *noise,
                       const Prior *prior, const Criteria *criteria, const double *starts, int64_t n,
                       double *ends, RunResult *last) {
    return follow_starts(target, source, noise, prior, criteria, starts, n, ends, last);
}

/* free_space.py */

double EXPORT(sum_violations)(const Target *target, const uint8_t *known, double max_range,
                              const Sample *sample, const double *T, int64_t *seen) {
    Violations sum = sum_violations(target, known, max_range, sample, T);
    *seen = sum.seen;
    return sum.cost;
}

double EXPORT(find_contradicted_share)(const Target *target, const Sample *of_target,
                                       const Target *source, const Sample *of_source, const double *T) {
    return find_contradicted_share(target, of_target, source, of_source, T);
}

/* algebra.py and pose_prior.py: their matrices are dense, those of the engine have rows of STATE */

static void spread_rows(const double *dense, int n, double *out) {
    for (int i = 0; i < n; i++) memcpy(out + STATE * i, dense + n * i, sizeof *out * (size_t)n);
}

static void pack_rows(const double *wide, int n, double *dense) {
    for (int i = 0; i < n; i++) memcpy(dense + n * i, wide + STATE * i, sizeof *dense * (size_t)n);
}

int64_t EXPORT(find_determined)(const double *H, const double *spurious, const int64_t *entries,
                                int64_t n, double reach, double *kept, double *honest, double *dropped) {
    double wide_H[STATE * STATE] = {0}, wide_spurious[STATE * STATE] = {0};
    Determined found;
    spread_rows(H, (int)n, wide_H);
    spread_rows(spurious, (int)n, wide_spurious);
    find_determined(wide_H, wide_spurious, entries, (int)n, reach, &found);
    pack_rows(found.kept, (int)n, kept);
    pack_rows(found.honest, (int)n, honest);
    pack_rows((const double *)found.dropped, (int)n, dropped);
    return found.n_dropped;
}

void EXPORT(invert_information)(const double *information, int64_t n, double least, double *out) {
    double wide[STATE * STATE] = {0}, inverse[STATE * STATE];
    spread_rows(information, (int)n, wide);
    invert_information(wide, (int)n, least, inverse);
    pack_rows(inverse, (int)n, out);
}

/* Write the information of the first `pose` of `size` entries with the others marginalised, whose prior
 * information is `known`: the Schur complement. */
void EXPORT(marginalise)(const double *information, int64_t size, int64_t pose, const double *known,
                         double *out) {
    Wide equations = {.size = (int)size};
    for (int i = 0; i < size; i++) 
        memcpy(equations.H + WIDE * i, information + size * i, sizeof *out * (size_t)size);
    for (int i = (int)pose; i < size; i++) add_prior(&equations, i, known[i - pose], 0);
    eliminate_last(&equations, (int)pose);
    for (int i = 0; i < pose; i++) 
        memcpy(out + pose * i, equations.H + WIDE * i, sizeof *out * (size_t)pose);
}

void EXPORT(displace)(const double *T, const double *steps, int64_t n, double *out) {
    for (int64_t k = 0; k < n; k++) displace(T, steps + 6 * k, out + 16 * k);
}

void EXPORT(find_deviation)(const double *T, const double *mean, double *off) {
    find_deviation(T, mean, off);
}

double EXPORT(expect_displacement)(const double *first, const double *second,
                                   const double *covariance) {
    double wide[STATE * STATE] = {0};
    spread_rows(covariance, POSE, wide);
    return expect_displacement(first, second, wide);
}

/* kd_tree.py, clouds/patches.py and clouds/pairs.py */

void EXPORT(build_tree)(const double *points, int64_t n, double *sorted, int32_t *order, uint8_t *axes) {
    Tree tree = {n, sorted, order, axes};
    memcpy(sorted, points, sizeof *sorted * 3 * (size_t)n);
    for (int64_t k = 0; k < n; k++) order[k] = (int32_t)k;
    build_tree(&tree, 0, n);
}

void EXPORT(find_nearest)(double *sorted, int32_t *order, uint8_t *axes, int64_t n, const double *from,
                     int64_t m, int64_t k, double *squares, int32_t *indices) {
    Tree tree = {n, sorted, order, axes};
    find_nearest(&tree, from, m, k, squares, indices);
}

void EXPORT(find_closest)(double *sorted, int32_t *order, uint8_t *axes, int64_t n, const double *from,
                     int64_t m, double within, double *distances, int64_t *indices) {
    Tree tree = {n, sorted, order, axes};
    find_closest(&tree, from, m, within, distances, indices);
}

void EXPORT(fit_neighbourhoods)(double *sorted, int32_t *order, uint8_t *axes, int64_t n, int64_t k,
                            double *centroids, double *normals, double *variances) {
    Tree tree = {n, sorted, order, axes};
    fit_neighbourhoods(&tree, k, centroids, normals, variances);
}

int64_t EXPORT(number_cells)(const int32_t *cells, int64_t n, int32_t *distinct, int32_t *numbers) {
    return number_cells(cells, n, distinct, numbers);
}

double EXPORT(find_median)(double *values, int64_t n) {
    return median(values, n);
}

void EXPORT(find_cells)(const double *points, int64_t n, double scale, int32_t *cells) {
    find_cells(points, n, scale, cells);
}

void EXPORT(sum_moments)(const double *points, const double *mean, const int32_t *numbers, int64_t n,
                         double *sums) {
    sum_moments(points, mean, numbers, n, sums);
}

void EXPORT(add_moments)(const double *moments, const int32_t *numbers, int64_t n, double *sums) {
    add_moments(moments, numbers, n, sums);
}

int64_t EXPORT(fit_patches)(double *sorted, int32_t *order, uint8_t *axes, int64_t n, const double *moments,
                            const double *radii, int64_t n_radii, double points, double flatness,
                            double width, double *patches, uint8_t *are_flat) {
    Tree tree = {n, sorted, order, axes};
    Flat flat = {points, flatness, width};
    return fit_patches(&tree, moments, radii, n_radii, &flat, patches, are_flat);
}

int64_t EXPORT(pair_patches)(double *sorted, int32_t *order, uint8_t *axes, int64_t n, const double *targets,
                            const double *sources, int64_t m, const double *T, double gate, double cosine,
                            double *pairs, int32_t *indices) {
    Tree tree = {n, sorted, order, axes};
    return pair_patches(&tree, targets, sources, m, T, gate, cosine, pairs, indices);
}

int64_t EXPORT(find_near)(const double *points, int64_t n, const double *places, int64_t m, double within,
                          uint8_t *near) {
    return find_near(points, n, places, m, within, near);
}

/* mixed_pixels.py, gap_filling.py, readings.py, costmap.py, fused_cloud.py and virtual_scan.py */

void EXPORT(mark_mixed_pixels)(const double *ranges, const double *elevations, int64_t own,
                               const double *yaws, int64_t n_lines, int64_t n_beams, double noise,
                               double steepest, uint8_t *mixed) {
    mark_mixed_pixels(ranges, elevations, own, yaws, n_lines, n_beams, noise, steepest, mixed);
}

void EXPORT(fill_gaps)(double *ranges, const double *elevations, int64_t own, const double *yaws,
                  int64_t n_lines, int64_t n_beams, double max_angle, double depth_edge) {
    fill_gaps(ranges, elevations, own, yaws, n_lines, n_beams, max_angle, depth_edge);
}

void EXPORT(place_readings)(const int64_t *index, int64_t n, int64_t n_beams, const double *ranges,
                    const double *c, const double *s, const double *rays, int64_t own,
                    const double *lever, double *points, int64_t *lines, int64_t *beams,
                    double *distance) {
    place_readings(index, n, n_beams, ranges, c, s, rays, own, lever, points, lines, beams, distance);
}

void EXPORT(meet_planes)(const int64_t *index, int64_t n, int64_t n_beams, const double *c, const double *s,
                         const double *rays, int64_t own, const double *lever, const double *normals,
                         const double *offsets, double *ranges) {
    meet_planes(index, n, n_beams, c, s, rays, own, lever, normals, offsets, ranges);
}

void EXPORT(find_near_points)(const int64_t *index, int64_t n, int64_t n_beams, const double *c,
                              const double *s, const double *rays, int64_t own, const double *lever,
                              const double *ranges, const double *points, const double *limits,
                              uint8_t *near) {
    find_near_points(index, n, n_beams, c, s, rays, own, lever, ranges, points, limits, near);
}

int64_t EXPORT(measure_free_reach)(const int64_t *lines, const double *distance, const uint8_t *kinds,
                                   int64_t n, int64_t n_lines, double start, double most, double margin,
                                   double *reach) {
    double *scratch = malloc(sizeof *scratch * (size_t)(n + 1));
    if (!scratch) return -1;
    measure_free_reach(lines, distance, kinds, n, n_lines, start, most, margin, scratch, reach);
    free(scratch);
    return 0;
}

void EXPORT(count_neighbours)(const double *ranges, const double *yaws, const double *elevations,
                        int64_t own, int64_t n_lines, int64_t n_beams, const int64_t *lines,
                        const int64_t *beams, int64_t n, double noise, double steepest,
                        int64_t *counts) {
    count_neighbours(ranges, yaws, elevations, own, n_lines, n_beams, lines, beams, n, noise, steepest,
                     counts);
}

/* grids.py and target/extraction.py */

int64_t EXPORT(dilate)(const uint8_t *grid, int64_t nx, int64_t ny, const int64_t *disc, int64_t n_rows,
                        uint8_t *out) {
    return dilate(grid, nx, ny, disc, n_rows, out);
}

int64_t EXPORT(label_components)(const uint8_t *grid, int64_t nx, int64_t ny, int32_t *labels) {
    return label_components(grid, nx, ny, labels);
}

int64_t EXPORT(find_shortest_paths)(const uint8_t *grid, int64_t nx, int64_t ny, int64_t start,
                                    double straight, double diagonal, double *lengths, int64_t *before) {
    return find_shortest_paths(grid, nx, ny, start, straight, diagonal, lengths, before);
}

int64_t EXPORT(measure_components)(const double *ranges, int64_t n_lines, int64_t n_beams,
                                   const int64_t *lines, const int64_t *beams, int64_t n, double most,
                                   int64_t *sizes) {
    return measure_components(ranges, n_lines, n_beams, lines, beams, n, most, sizes);
}

/* moving_windows.py */

int64_t EXPORT(average_windows)(const double *values, int64_t outer, int64_t n, int64_t inner,
                                int64_t size, double *out) {
    return average_windows(values, outer, n, inner, size, out);
}

/* costmap.py */

int64_t EXPORT(mark_floor)(int64_t *cells, int64_t nx, int64_t ny, const double *origin, double side,
                           const double *pose, const double *yaws, const double *reach, int64_t n,
                           const double *points, int64_t m) {
    Floor floor = {cells, nx, ny, origin, side};
    return mark_floor(&floor, pose, yaws, reach, n, points, m);
}

/* hidden_surface.py */

void EXPORT(find_hidden)(const uint8_t *surface, int64_t nx, int64_t ny, const double *origin, const double *end,
                         double side, const double *points, const double *normals, const int64_t *slices,
                         int64_t n, const double *place, const double *steps, int64_t m, uint8_t *hidden) {
    SliceGrids grids = {surface, nx, ny, origin, end, side};
    find_hidden(&grids, points, normals, slices, n, place, steps, m, hidden);
}

/* Write the sizes of the structures in the order of engine.h, for a test that Python's agree. */

void EXPORT(write_struct_sizes)(int64_t *sizes) {
    const int64_t own[] = {sizeof(Sweep), sizeof(ScanSurfels), sizeof(Projection), sizeof(Target),
                           sizeof(Sample), sizeof(Source), sizeof(PairNoise), sizeof(Prior),
                           sizeof(Criteria), sizeof(Gate), sizeof(Equations), sizeof(RunResult)};
    memcpy(sizes, own, sizeof own);
}
