// Python bindings of the kernels in `shapes`.
#include <nanobind/stl/array.h>
#include <nanobind/stl/complex.h>

#include "plate/binding.hpp"
#include "shapes/background.hpp"
#include "shapes/catalogue.hpp"
#include "shapes/outlines.hpp"
#include "shapes/placing.hpp"
#include "shapes/segmentation.hpp"
#include "shapes/shadows.hpp"
#include "shapes/splitting.hpp"

namespace plate {

namespace {

using nb::arg;
using Image = In<uint8_t, 2>;
using Colours = In<uint8_t, 3>;
using Labels = In<int32_t, 2>;

void require_edges(const In<double, 2>& edges) {
    require(edges.shape(0) > 0 && edges.shape(1) == 5, "shape: edges (e, 5), e >= 1");
}

// Throw an error unless the numbers in `ends` increase, so that each ring has at least one point.
void require_rings(const In<int64_t, 1>& ends, size_t points) {
    int64_t first = 0;
    for (size_t i = 0; i < ends.shape(0); first = ends(i), i++)
        require(first < ends(i) && ends(i) <= static_cast<int64_t>(points),
                "ends: allowed: rising, up to the number of points");
}

const Complex* as_spectrum(const In<std::complex<double>, 1>& spectrum) {
    require(spectrum.shape(0) == HARMONICS, "shape: spectrum (HARMONICS,)");
    return reinterpret_cast<const Complex*>(spectrum.data());
}

// Convert structs that contain only numbers to the rows of an array.
template <class Record>
auto rows_of(const std::vector<Record>& records) {
    constexpr size_t WIDE = sizeof(Record) / sizeof(double);
    const auto* numbers = reinterpret_cast<const double*>(records.data());
    return to_numpy<2>(std::vector<double>(numbers, numbers + WIDE * records.size()),
                       {records.size(), WIDE});
}

auto as_array(const PoseFit& fit) {
    return to_numpy<1>(std::vector{fit.x, fit.y, fit.angle, fit.swell, fit.rest}, {5});
}

void bind_outlines(nb::module_& m) {
    m.attr("HARMONICS") = HARMONICS;

    m.def("contrast", [](Colours pixels, Image mask, Image inner, Image around,
                         Array<float, 2> field, Array<double, 1> colour) {
        require(same_pixels(pixels, field) && same_pixels(mask, inner, around) &&
                    mask.shape(0) == pixels.shape(0) + 2 && mask.shape(1) == pixels.shape(1) + 2 &&
                    colour.shape(0) == pixels.shape(2),
                "shapes: pixels (h, w, c), field (h, w), colour (c,), the others (h + 2, w + 2)");
        nb::gil_scoped_release others_may_run;
        contrast(view(pixels), view(mask), view(inner), view(around), view(field), colour.data());
    }, arg(), arg(), arg(), arg(), arg().noconvert(), arg().noconvert());
    m.def("find_edge", [](In<float, 2> field, In<int32_t, 2> ring, bool hole,
                          Array<double, 2> points) {
        require(field.shape(0) > 1 && field.shape(1) > 1 && ring.shape(0) > 0 &&
                    ring.shape(1) == 2 && points.shape(1) == 2,
                "shapes: field (h, w), two pixels each way, ring (k, 2), k >= 1, points (n, 2)");
        nb::gil_scoped_release others_may_run;
        find_edge(view(field), view(ring), hole, view(points));
    }, arg(), arg(), arg(), arg().noconvert());
    m.def("measure_outline", [](Array<double, 2> points, In<int64_t, 1> ends,
                                Array<std::complex<double>, 1> spectrum) {
        require(points.shape(0) > 0 && points.shape(1) == 2 && spectrum.shape(0) == HARMONICS,
                "shapes: points (n, 2), n >= 1, spectrum (HARMONICS,)");
        require_rings(ends, points.shape(0));
        OutlineMeasures found;
        {
            nb::gil_scoped_release others_may_run;
            found = measure_outline(view(points), view(ends));
        }
        for (int k = 0; k < HARMONICS; k++)
            spectrum(k) = {found.spectrum[k].real, found.spectrum[k].imag};
        return nb::make_tuple(found.area, found.x, found.y);
    }, arg().noconvert(), arg(), arg().noconvert());
    m.def("outline_edges", [](In<double, 2> points, In<int64_t, 1> ends) {
        require(points.shape(1) == 2, "shape: points (n, 2)");
        require_rings(ends, points.shape(0));
        std::vector<double> edges = outline_edges(view(points), view(ends));
        const size_t count = edges.size() / 5;
        return to_numpy<2>(std::move(edges), {count, 5});
    });
    m.def("distances", [](In<double, 2> edges, In<double, 2> points) {
        require_edges(edges);
        require(points.shape(1) >= 2, "shape: points (n, 2)");
        const size_t count = points.shape(0);
        std::vector<double> found(3 * count);
        {
            nb::gil_scoped_release others_may_run;
            const View<const double, 2> at = view(points);
            Places places(count);
            for (size_t i = 0; i < count; i++) places.x[i] = at(i, 0), places.y[i] = at(i, 1);
            edge_distances(view(edges), places);
            for (size_t i = 0; i < count; i++) {
                found[3 * i] = places.distance[i];
                found[3 * i + 1] = places.right[i], found[3 * i + 2] = places.down[i];
            }
        }
        return to_numpy<2>(std::move(found), {count, 3});
    });
    m.def("fit_pose", [](In<double, 2> edges, In<double, 2> points, In<double, 1> pose, double unit,
                         bool turns, int steps, double hopeless, double gate) {
        require_edges(edges);
        require(points.shape(1) >= 2 && pose.shape(0) >= 3, "shapes: points (n, 2), pose (3,)");
        require(steps >= 0 && steps <= 1000, "steps: allowed: 0 to 1000");
        PoseFit fit;
        {
            nb::gil_scoped_release others_may_run;
            fit = fit_pose(view(edges), view(points), pose.data(), unit, turns, steps, hopeless,
                           gate);
        }
        return as_array(fit);
    });
    m.def("turn_scatter", [](In<double, 2> edges, In<double, 2> points, In<double, 1> fit,
                             double full, double unit, double gate) {
        require_edges(edges);
        require(points.shape(1) >= 2 && fit.shape(0) >= 4, "shapes: points (n, 2), fit (5,)");
        nb::gil_scoped_release others_may_run;
        return turn_scatter(view(edges), view(points), fit.data(), full, unit, gate);
    });
    m.def("lay_on", [](In<double, 2> edges, In<double, 2> samples, In<double, 1> own,
                       In<std::complex<double>, 1> known, int symmetry, In<double, 2> rim,
                       In<double, 1> centre, In<std::complex<double>, 1> seen, double unit,
                       double hopeless) {
        require_edges(edges);
        require_edges(rim);
        require(samples.shape(1) == 4 && own.shape(0) == 2 && centre.shape(0) == 2 && symmetry >= 0,
                "shapes: samples (n, 4), own and centre (2,); symmetry: allowed: 0 or more");
        const TypeOutline type{view(edges), view(samples), own.data(), as_spectrum(known),
                               symmetry};
        const SeenOutline outline{view(rim), centre.data(), as_spectrum(seen)};
        PoseFit fit;
        {
            nb::gil_scoped_release others_may_run;
            fit = lay_on(type, outline, unit, hopeless);
        }
        return as_array(fit);
    });
}

void bind_placing(nb::module_& m) {
    m.attr("NEAR_PX") = NEAR_PX;
    m.attr("OUTSIDE_PX") = OUTSIDE_PX;
    m.attr("MAX_OUTSIDE") = MAX_OUTSIDE;

    m.def("support", [](In<float, 2> free, In<float, 2> border, In<double, 2> to_px,
                        In<double, 2> rim, In<double, 2> inner, In<double, 1> pose) {
        require(same_pixels(free, border) && to_px.shape(0) == 2 && to_px.shape(1) == 3 &&
                    rim.shape(1) >= 2 && inner.shape(1) == 2 && pose.shape(0) >= 3,
                "shapes: free and border (h, w), to_px (2, 3), rim and inner (n, 2), pose (3,)");
        nb::gil_scoped_release others_may_run;
        const Support found =
            support(view(free), view(border), view(to_px), view(rim), view(inner), pose.data());
        return std::array{found.seen, found.outside};
    });
    m.def("search", [](In<float, 2> free, In<float, 2> border, In<double, 2> to_px,
                       In<double, 2> rim, In<double, 2> inner, In<double, 1> pole, double depth,
                       In<double, 1> turns, int stride) {
        require(same_pixels(free, border) && to_px.shape(0) == 2 && to_px.shape(1) == 3 &&
                    rim.shape(1) >= 2 && inner.shape(1) == 2 && pole.shape(0) == 2 && stride > 0,
                "shapes: free and border (h, w), to_px (2, 3), rim and inner (n, 2), pole (2,); "
                "stride: allowed: 1 or more");
        std::vector<PlaceFound> found;
        {
            nb::gil_scoped_release others_may_run;
            found = search(view(free), view(border), view(to_px), view(rim), view(inner),
                           pole.data(), depth, view(turns), stride);
        }
        return rows_of(found);
    });
}

void bind_segmentation(nb::module_& m) {
    m.attr("MIN_AREA_PX2") = MIN_AREA_PX2;

    m.def("deviation", [](Colours lab, Colours bare, double chroma, Array<uint8_t, 2> out) {
        const size_t channels = lab.shape(2);
        require(same_pixels(lab, bare, out) && bare.shape(2) == channels &&
                    (channels == 1 || channels == 3),
                "shapes: lab and bare (h, w, 1 or 3), out (h, w)");
        nb::gil_scoped_release others_may_run;
        if (channels == 1)
            deviation_of_greys(lab.data(), bare.data(), out.data(), out.size());
        else
            deviation_of_colours(lab.data(), bare.data(), chroma * chroma, out.data(), out.size());
    }, arg(), arg(), arg(), arg().noconvert());
    m.attr("LIGHTNESS_0") = LIGHTNESS_0;
    m.def("relight", [](Colours bare, In<float, 2> surface, In<float, 1> place,
                        std::array<int, 4> box, Array<uint8_t, 3> out) {
        const size_t channels = bare.shape(2);
        const auto [x0, y0, x1, y1] = box;
        require(same_pixels(bare, out) && out.shape(2) == channels &&
                    (channels == 1 || channels == 3) && surface.shape(0) == 6 &&
                    surface.shape(1) == channels && place.shape(0) == 3,
                "shapes: bare and out (h, w, 1 or 3), surface (6, 1 or 3), place (3,)");
        require(0 <= x0 && x0 <= x1 && x1 <= static_cast<int>(bare.shape(1)) && 0 <= y0 &&
                    y0 <= y1 && y1 <= static_cast<int>(bare.shape(0)),
                "box: allowed: columns and rows of the image");
        nb::gil_scoped_release others_may_run;
        relight(view(bare), view(surface), place.data(), {x0, y0, x1, y1}, view(out));
    }, arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("find_contrasts", [](Labels labels, Image away, Image brighter, Image slope,
                               Array<float, 1> contrast, Array<float, 1> steepest,
                               Array<bool, 1> bright) {
        const size_t count = contrast.shape(0);
        require(same_pixels(labels, away, brighter, slope) && steepest.shape(0) == count &&
                    bright.shape(0) == count,
                "shapes: images (h, w); contrast, steepest and bright (count,)");
        nb::gil_scoped_release others_may_run;
        find_contrasts(view(labels), view(away), view(brighter), view(slope), view(contrast),
                       steepest.data(), bright.data());
    }, arg(), arg(), arg(), arg(), arg().noconvert(), arg().noconvert(), arg().noconvert());
    m.def("find_cover", [](Image away, Image around, Image brighter, Image slope, Labels labels,
                           In<float, 1> contrast, In<float, 1> steepest, In<bool, 1> bright,
                           Image limit, Array<float, 2> cover) {
        const size_t count = contrast.shape(0);
        require(same_pixels(labels, away, around, brighter, slope, limit, cover) &&
                    steepest.shape(0) == count && bright.shape(0) == count,
                "shapes: images (h, w); contrast, steepest and bright (count,)");
        nb::gil_scoped_release others_may_run;
        find_cover(view(away), view(around), view(brighter), view(slope), view(labels),
                   {static_cast<int>(count), contrast.data(), steepest.data(), bright.data()},
                   view(limit), view(cover));
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert());
    m.def("bridge", [](Array<uint8_t, 2> mask, Array<float, 2> cover, Image near, Image far,
                       Image step, Image around) {
        require(same_pixels(mask, cover, near, far, step, around), "shapes: all (h, w)");
        nb::gil_scoped_release others_may_run;
        bridge(view(mask), view(cover), view(near), view(far), view(step), view(around));
    }, arg().noconvert(), arg().noconvert(), arg(), arg(), arg(), arg());
    m.def("find_basins", [](In<float, 2> depth, double neck, double min_drop, int levels,
                            Array<int32_t, 2> labels) {
        require(same_pixels(depth, labels), "shapes: depth and labels (h, w)");
        require(levels >= 1, "levels: allowed: 1 or more");
        std::fill_n(labels.data(), labels.size(), 0);
        Basins found;
        {
            nb::gil_scoped_release others_may_run;
            found = find_basins(view(depth), neck, min_drop, levels, view(labels));
        }
        return nb::make_tuple(found.count, rows_of(found.necks));
    }, arg(), arg(), arg(), arg(), arg().noconvert());
}

void bind_shadows(nb::module_& m) {
    m.attr("LIGHTER") = LIGHTER;

    m.def("find_shadow_edges", [](Colours lab, Colours bare, double chroma, Image limit,
                                  Labels labels, Array<bool, 2> like, Array<bool, 2> lit,
                                  Array<float, 2> slope, Array<float, 1> steepest,
                                  Array<float, 1> largest, Array<int64_t, 1> total,
                                  Array<int64_t, 1> balance) {
        const size_t count = steepest.shape(0);
        require(same_pixels(lab, bare, limit, labels, like, lit, slope) && lab.shape(2) >= 1 &&
                    bare.shape(2) == lab.shape(2) && largest.shape(0) == count &&
                    total.shape(0) == count && balance.shape(0) == count,
                "shapes: lab and bare (h, w, c), images (h, w), the rest (count,)");
        nb::gil_scoped_release others_may_run;
        find_shadow_edges(view(lab), view(bare), chroma, view(limit), view(labels),
                          {static_cast<int>(count), view(like), view(lit), view(slope),
                           steepest.data(), largest.data(), total.data(), balance.data()});
    }, arg(), arg(), arg(), arg(), arg(), arg().noconvert(), arg().noconvert(), arg().noconvert(),
       arg().noconvert(), arg().noconvert(), arg().noconvert(), arg().noconvert());
    m.def("part_sides", [](Image away, In<bool, 2> like, In<float, 2> slope, In<float, 1> steepest,
                           Labels labels, Array<float, 1> bound, Array<float, 1> light,
                           Array<float, 1> dark) {
        const size_t count = bound.shape(0);
        require(same_pixels(away, like, slope, labels) && steepest.shape(0) == count &&
                    light.shape(0) == count && dark.shape(0) == count,
                "shapes: images (h, w), the rest (count,)");
        nb::gil_scoped_release others_may_run;
        part_sides(view(away), view(like), view(slope), steepest.data(), view(labels), view(bound),
                   light.data(), dark.data());
    }, arg(), arg(), arg(), arg(), arg(), arg().noconvert(), arg().noconvert(),
       arg().noconvert());
    m.def("find_fade", [](Image away, Image around, In<bool, 2> like, In<float, 2> slope,
                          Labels labels, In<float, 1> bound, In<float, 1> level,
                          Array<float, 1> fade, Array<double, 2> way) {
        const size_t count = bound.shape(0);
        require(same_pixels(away, around, like, slope, labels) && level.shape(0) == count &&
                    fade.shape(0) == count && way.shape(0) == count && way.shape(1) == 2,
                "shapes: images (h, w), bound, level and fade (count,), way (count, 2)");
        nb::gil_scoped_release others_may_run;
        find_fade(view(away), view(around), view(like), view(slope), view(labels), view(bound),
                  level.data(), fade.data(), view(way));
    }, arg(), arg(), arg(), arg(), arg(), arg(), arg(), arg().noconvert(), arg().noconvert());
}

}  // namespace

void bind_shapes(nb::module_& m) {
    bind_outlines(m);
    bind_placing(m);
    bind_segmentation(m);
    bind_shadows(m);
}

}  // namespace plate
