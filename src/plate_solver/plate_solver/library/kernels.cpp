// Python bindings of the kernels in this folder.
#include "library/simplex.hpp"
#include "records.hpp"

namespace plate {

using namespace library;
using nb::arg;

// Throws an error if an index in `basis` is not from 0 to `columns` - 1.
static void check_basis(const View<const int64_t, 1>& basis, size_t columns) {
    for (int i = 0; i < basis.size(0); i++)
        if (basis(i) < 0 || basis(i) >= static_cast<int64_t>(columns))
            throw nb::value_error("the basis contains the index of a column that does not exist");
}

static int improve(Table matrix, Numbers right_side, Numbers price, Array<int64_t, 1> basis,
                   Array<double, 1> sense, int pivots) {
    const size_t rows = matrix.shape(0), columns = matrix.shape(1) + 2 * rows;
    check("right_side", right_side, {rows}), check("price", price, {columns});
    check("basis", basis, {rows}), check("sense", sense, {rows});
    check_basis({basis.data(), {static_cast<int>(rows)}}, columns);
    nb::gil_scoped_release others_may_run;
    Programme programme{view(matrix), view(right_side), view(price), view(basis), view(sense)};
    return programme.simplex(pivots);
}

static nb::object chosen(Table matrix, Array<const int64_t, 1> basis) {
    const int rows = static_cast<int>(matrix.shape(0));
    check("basis", basis, {matrix.shape(0)});
    check_basis(view(basis), matrix.shape(1) + 2 * matrix.shape(0));
    Matrix result(rows, rows);
    columns_of(view(matrix), view(basis), {result[0], {rows, rows}});
    return to_numpy(std::move(result));
}

void bind_library(nb::module_& m) {
    m.def("columns_of", chosen);
    m.def("simplex", improve, arg("matrix"), arg("right_side"), arg("price"),
          arg("basis").noconvert(), arg("sense").noconvert(), arg("pivots"));
}

}  // namespace plate
