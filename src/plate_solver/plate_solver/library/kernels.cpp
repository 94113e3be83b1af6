// Python bindings of the kernels in this folder.
#include "library/simplex.hpp"
#include "records.hpp"

namespace plate {

using namespace library;
using nb::arg;

static int improve(Table matrix, Numbers right_side, Numbers price, Array<int64_t, 1> basis,
                   Array<double, 1> sense, int pivots) {
    const size_t rows = matrix.shape(0), columns = matrix.shape(1) + 2 * rows;
    check("right_side", right_side, {rows}), check("price", price, {columns});
    check("basis", basis, {rows}), check("sense", sense, {rows});
    for (size_t i = 0; i < rows; i++)
        if (basis(i) < 0 || basis(i) >= static_cast<int64_t>(columns))
            throw nb::value_error("the basis contains the index of a column that does not exist");
    nb::gil_scoped_release others_may_run;
    Programme programme{view(matrix), view(right_side), view(price), view(basis), view(sense)};
    return programme.simplex(pivots);
}

void bind_library(nb::module_& m) {
    m.def("simplex", improve, arg("matrix"), arg("right_side"), arg("price"),
          arg("basis").noconvert(), arg("sense").noconvert(), arg("pivots"));
}

}  // namespace plate
