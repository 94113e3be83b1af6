// Bindings of the chapter `discs`.
#include <nanobind/stl/array.h>

#include "discs/fit.hpp"
#include "discs/marks.hpp"
#include "discs/measure.hpp"
#include "discs/seeds.hpp"
#include "plate/binding.hpp"

namespace plate {

namespace {

using nb::arg;

constexpr double MOST_RADIUS_PX = 1e4;

void require_radius(double radius) {
    require(radius > 0 && radius <= MOST_RADIUS_PX, "radius: allowed: more than 0, up to 1e4 px");
}

bool are_pairs(const In<double, 2>& places) { return places.shape(1) == 2; }

// Rows of numbers that are discs.
Disc* as_discs(const Array<double, 2>& rows, size_t count) {
    require(rows.shape(0) == count && rows.shape(1) == sizeof(Disc) / sizeof(double),
            "shape: discs (n, 5)");
    return reinterpret_cast<Disc*>(rows.data());
}

Grid as_grid(const std::array<int, 3>& grid) {
    require(grid[0] >= 0 && grid[1] >= 0 && grid[2] > 0, "grid: allowed: x, y >= 0, step >= 1");
    return {grid[0], grid[1], grid[2]};
}

}  // namespace

void bind_discs(nb::module_& m) {
    m.attr("RIM_PX") = RIM_PX;

    m.def("measure_alone", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                              In<int64_t, 2> seeds, double radius, In<bool, 1> alone,
                              Array<double, 2> discs, Array<double, 1> dirt) {
        const LitPlate plate = lit_plate(grey, light, usable);
        const size_t count = seeds.shape(0);
        require(seeds.shape(1) == 2 && alone.shape(0) == count && dirt.shape(0) == count,
                "shapes: seeds (n, 2), alone and dirt (n,)");
        Disc* out = as_discs(discs, count);
        require_radius(radius);
        nb::gil_scoped_release others_may_run;
        measure_alone(plate, view(seeds), radius, alone.data(), out, dirt.data());
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert(), arg().noconvert());
    m.def("crowded", [](In<double, 2> centre, double distance_px, Array<bool, 1> near) {
        require(are_pairs(centre) && near.shape(0) == centre.shape(0),
                "shapes: centre (n, 2), near (n,)");
        nb::gil_scoped_release others_may_run;
        crowded(view(centre), distance_px, near.data());
    }, arg(), arg(), arg().noconvert());
    m.def("fit_discs", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                          In<double, 2> seeds, double radius, Array<double, 2> discs) {
        const LitPlate plate = lit_plate(grey, light, usable);
        require(are_pairs(seeds), "shape: seeds (n, 2)");
        Disc* out = as_discs(discs, seeds.shape(0));
        require_radius(radius);
        nb::gil_scoped_release others_may_run;
        fit_discs(plate, view(seeds), radius, out);
    }, arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("find_marks", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                           In<double, 2> seeds, double radius) {
        const LitPlate plate = lit_plate(grey, light, usable);
        require(are_pairs(seeds), "shape: seeds (n, 2)");
        require_radius(radius);
        const size_t count = seeds.shape(0);
        const std::array<int, 2> shape{static_cast<int>(count), 2};
        std::vector<double> found(2 * count), level(2 * count);
        {
            nb::gil_scoped_release others_may_run;
            find_marks(plate, view(seeds), radius, {found.data(), shape}, {level.data(), shape});
        }
        return nb::make_tuple(to_numpy<2>(std::move(found), {count, 2}),
                              to_numpy<2>(std::move(level), {count, 2}));
    });
    m.def("paint_marks", [](Array<uint8_t, 2> grey, In<double, 2> centre, In<double, 2> level,
                            double radius) {
        require(are_pairs(centre) && are_pairs(level) && level.shape(0) == centre.shape(0),
                "shapes: centre and level (n, 2)");
        nb::gil_scoped_release others_may_run;
        paint_marks(view(grey), view(centre), view(level), radius);
    }, arg().noconvert(), arg(), arg(), arg());
    m.def("find_dark", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable,
                          double threshold, std::array<int, 3> corner, In<bool, 2> outside,
                          Array<uint8_t, 2> dark) {
        const LitPlate plate = lit_plate(grey, light, usable);
        const Grid grid = as_grid(corner);
        const int64_t rows = dark.shape(0), columns = dark.shape(1);
        require(same_pixels(dark, outside), "shapes: dark and outside (h, w)");
        require(grid.y + (rows - 1) * grid.step < plate.height() &&
                    grid.x + (columns - 1) * grid.step < plate.width(),
                "the grid leaves the image");
        nb::gil_scoped_release others_may_run;
        find_dark(plate, threshold, grid, view(outside), view(dark));
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("find_blobs", [](Array<bool, 2> core, double least, double most, Array<bool, 2> merged) {
        require(same_pixels(core, merged), "shapes: core and merged (h, w)");
        Blobs found;
        {
            nb::gil_scoped_release others_may_run;
            found = find_blobs(view(core), least, most, view(merged));
        }
        const size_t whole = found.centres.size() / 2, large = found.boxes.size() / 4;
        return nb::make_tuple(to_numpy<2>(std::move(found.centres), {whole, 2}),
                              to_numpy<2>(std::move(found.boxes), {large, 4}));
    }, arg().noconvert(), arg(), arg(), arg().noconvert());
    m.def("vote", [](In<uint8_t, 2> grey, In<float, 1> light, In<bool, 2> usable, int x0, int y0,
                     double radius, Array<float, 2> votes) {
        const LitPlate plate = lit_plate(grey, light, usable);
        nb::gil_scoped_release others_may_run;
        vote(plate, x0, y0, radius, view(votes));
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("find_peaks", [](In<float, 2> votes, int x0, int y0, In<bool, 2> merged,
                           std::array<int, 3> grid, double radius) {
        require(radius > 0, "radius is not above 0");
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
