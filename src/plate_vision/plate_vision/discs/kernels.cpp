// Python bindings of the kernels in `discs`.
#include <nanobind/stl/array.h>

#include "discs/dark.hpp"
#include "discs/fit.hpp"
#include "discs/judge.hpp"
#include "discs/marks.hpp"
#include "discs/measure.hpp"
#include "discs/seeds.hpp"
#include "discs/silhouette.hpp"
#include "plate/binding.hpp"
#include "remains.hpp"

namespace plate {

namespace {

using nb::arg;

constexpr double MAX_RADIUS_PX = 1e4;

bool is_radius(double radius) { return radius > 0 && radius <= MAX_RADIUS_PX; }

// Returns the rows of an array as silhouettes.
const Silhouette* as_silhouettes(const In<double, 2>& rows, size_t count) {
    require(rows.shape(0) == count && rows.shape(1) == sizeof(Silhouette) / sizeof(double),
            "shape: silhouettes (n, 8)");
    const auto* parts = reinterpret_cast<const Silhouette*>(rows.data());
    for (size_t k = 0; k < count; k++) {
        require(is_radius(parts[k].radius_px), "radius: allowed: more than 0, up to 1e4 px");
        require(parts[k].is_finite() && parts[k].reach() <= 2 * MAX_RADIUS_PX,
                "silhouettes: allowed: an area, and a reach of up to 2e4 px");
    }
    return parts;
}

template <class Rows>
bool are_pairs(const Rows& places) {
    return places.shape(1) == 2;
}

constexpr size_t DISC_NUMBERS = sizeof(Disc) / sizeof(double);

// Returns the rows of an array as discs.
Disc* as_discs(const Array<double, 2>& rows, size_t count) {
    require(rows.shape(0) == count && rows.shape(1) == DISC_NUMBERS, "shape: discs (n, 7)");
    return reinterpret_cast<Disc*>(rows.data());
}

Grid as_grid(const std::array<int, 3>& grid) {
    require(grid[0] >= 0 && grid[1] >= 0 && grid[2] > 0, "grid: allowed: x, y >= 0, step >= 1");
    return {grid[0], grid[1], grid[2]};
}

}  // namespace

void bind_discs(nb::module_& m) {
    m.attr("GOOD_MISFIT") = GOOD_MISFIT;

    m.def("measure_dark", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                             double noise, In<double, 2> edges, In<double, 2> bows,
                             In<double, 2> seeds, In<double, 2> parts, Array<double, 2> discs,
                             Array<double, 2> marks, Array<bool, 1> alone) {
        const LitPlate plate = lit_plate(grey, light, usable);
        const size_t count = seeds.shape(0);
        require(count > 0 && are_pairs(seeds) && are_pairs(marks) && marks.shape(0) == count &&
                    alone.shape(0) == count,
                "shapes: seeds and marks (n, 2), alone (n,), n >= 1");
        require_edges(edges, bows);
        Disc* out = as_discs(discs, count);
        const Silhouette* shapes = as_silhouettes(parts, count);
        nb::gil_scoped_release others_may_run;
        measure_dark(plate, noise, view(edges), view(bows), view(seeds), shapes, out, view(marks),
                     alone.data());
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert(),
       arg().noconvert(), arg().noconvert());
    m.def("judge", [](In<double, 2> discs, In<double, 2> parts, In<double, 2> marks,
                      In<double, 1> light, In<double, 2> edges, In<double, 2> bows, double noise,
                      double tolerance, double class_threshold, double margin_px) {
        const size_t count = discs.shape(0);
        require(discs.shape(1) == DISC_NUMBERS && are_pairs(marks) && marks.shape(0) == count &&
                    light.shape(0) == count,
                "shapes: discs (n, 7), marks (n, 2), light (n,)");
        require_edges(edges, bows);
        const auto* measured = reinterpret_cast<const Disc*>(discs.data());
        const Silhouette* shapes = as_silhouettes(parts, count);
        Parts kept;
        {
            nb::gil_scoped_release others_may_run;
            const std::vector<double> depth = depths(view(edges), view(bows), view(discs));
            kept = judge(measured, shapes, view(marks), light.data(), depth.data(),
                         {noise, tolerance, class_threshold, margin_px});
        }
        constexpr size_t NUMBERS = sizeof(Judged) / sizeof(double);
        const size_t found = kept.found.size();
        std::vector<double> numbers(NUMBERS * found);
        std::copy_n(reinterpret_cast<const double*>(kept.found.data()), numbers.size(),
                    numbers.data());
        return nb::make_tuple(to_numpy<1>(std::move(kept.rows), {found}),
                              to_numpy<1>(std::move(kept.labels), {found}),
                              to_numpy<2>(std::move(numbers), {found, NUMBERS}));
    });
    m.def("crowded", [](In<double, 2> centre, double distance_px, Array<bool, 1> near) {
        require(are_pairs(centre) && near.shape(0) == centre.shape(0),
                "shapes: centre (n, 2), near (n,)");
        nb::gil_scoped_release others_may_run;
        crowded(view(centre), distance_px, near.data());
    }, arg(), arg(), arg().noconvert());
    m.def("fit_discs", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                          In<double, 2> seeds, In<double, 2> parts, In<double, 2> cast,
                          double shade, double edge_px, double noise, Array<double, 2> discs) {
        const LitPlate plate = lit_plate(grey, light, usable);
        require(are_pairs(seeds), "shape: seeds (n, 2)");
        Disc* out = as_discs(discs, seeds.shape(0));
        const Silhouette* shapes = as_silhouettes(parts, seeds.shape(0));
        require(shade == 0 || (are_pairs(cast) && cast.shape(0) == seeds.shape(0)),
                "shape: cast (n, 2)");
        require(shade >= 0 && shade <= 1 && edge_px > 0, "shade: allowed: 0 to 1, edge_px: above 0");
        for (size_t k = 0; shade > 0 && k < cast.shape(0); k++)
            require(length_of(cast(k, 0), cast(k, 1)) <= MAX_RADIUS_PX,
                    "cast: allowed: up to 1e4 px");
        nb::gil_scoped_release others_may_run;
        fit_discs(plate, view(seeds), shapes, {cast.data(), shade, edge_px}, noise, out);
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("find_marks", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                           double noise, In<double, 2> seeds, In<double, 2> parts) {
        const LitPlate plate = lit_plate(grey, light, usable);
        const size_t count = seeds.shape(0);
        require(are_pairs(seeds), "shape: seeds (n, 2)");
        const Silhouette* shapes = as_silhouettes(parts, count);
        std::vector<double> marks(2 * count);
        {
            nb::gil_scoped_release others_may_run;
            without_marks(plate, noise, view(seeds), shapes,
                          {marks.data(), {static_cast<int>(count), 2}});
        }
        return to_numpy<2>(std::move(marks), {count, 2});
    });
    m.def("find_dark", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                          double threshold, std::array<int, 3> corner, In<bool, 2> outside,
                          Array<uint8_t, 2> dark) {
        const LitPlate plate = lit_plate(grey, light, usable);
        const Grid grid = as_grid(corner);
        const int64_t rows = dark.shape(0), columns = dark.shape(1);
        require(same_pixels(dark, outside), "shapes: dark and outside (h, w)");
        require(grid.y + (rows - 1) * grid.step < plate.height() &&
                    grid.x + (columns - 1) * grid.step < plate.width(),
                "grid: allowed: inside the image");
        nb::gil_scoped_release others_may_run;
        find_dark(plate, threshold, grid, view(outside), view(dark));
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("clear_parts", [](Array<uint8_t, 2> deviating, std::array<int, 3> grid,
                            In<double, 2> places, In<double, 2> parts) {
        require(are_pairs(places) && grid[2] > 0, "shape: places (n, 2), grid: allowed: a step");
        const Silhouette* shapes = as_silhouettes(parts, places.shape(0));
        nb::gil_scoped_release others_may_run;
        clear_parts(view(deviating), grid, view(places), shapes);
    }, arg().noconvert(), arg(), arg(), arg());
    m.def("any_deviating", [](In<uint8_t, 3> image, In<float, 2> lights, double limit,
                        In<bool, 2> counts, std::array<int, 3> grid, In<double, 2> places,
                        In<double, 2> parts) {
        require_lights(image, lights);
        require_grid(grid, counts.shape(0), counts.shape(1), image);
        require(are_pairs(places), "shape: places (n, 2)");
        const Silhouette* shapes = as_silhouettes(parts, places.shape(0));
        nb::gil_scoped_release others_may_run;
        return any_deviating(view(image), view(lights), limit, view(counts), grid, view(places),
                             shapes);
    });
    m.def("find_blobs", [](Array<bool, 2> core, Array<int32_t, 2> number) {
        require(same_pixels(core, number), "shapes: core and number (h, w)");
        std::vector<Blob> found;
        {
            nb::gil_scoped_release others_may_run;
            found = find_blobs(view(core), view(number));
        }
        constexpr size_t NUMBERS = sizeof(Blob) / sizeof(double);
        std::vector<double> rows(NUMBERS * found.size());
        std::copy_n(reinterpret_cast<const double*>(found.data()), rows.size(), rows.data());
        return to_numpy<2>(std::move(rows), {found.size(), NUMBERS});
    }, arg().noconvert(), arg().noconvert());
    m.def("vote", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable, int x0, int y0,
                     In<double, 2> part, Array<float, 2> votes) {
        const LitPlate plate = lit_plate(grey, light, usable);
        const Silhouette* shape = as_silhouettes(part, 1);
        nb::gil_scoped_release others_may_run;
        vote(plate, x0, y0, *shape, view(votes));
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("find_peaks", [](In<float, 2> votes, int x0, int y0, In<bool, 2> merged,
                           std::array<int, 3> grid, double radius) {
        require(radius > 0, "radius: allowed: above 0");
        std::vector<double> found;
        {
            nb::gil_scoped_release others_may_run;
            found = find_peaks(view(votes), x0, y0, view(merged), as_grid(grid), radius);
        }
        const size_t count = found.size() / 2;
        return to_numpy<2>(std::move(found), {count, 2});
    });
    m.def("nearest", [](In<double, 2> centres, double x, double y) {
        require(are_pairs(centres), "shape: centres (n, 2)");
        return nearest(centres.data(), centres.shape(0), x, y);
    });
}

}  // namespace plate
