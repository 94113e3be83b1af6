// PLATE_WIDE: the function is compiled for several vector widths. The loader of the operating
// system selects one.
//
// Results do not depend on the width: the order of sums is fixed, and products are not fused with
// sums. Vectors of 512 bits are excluded, because GCC 12 then loads past the ends of arrays
// (test_native.py).
#pragma once

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define PLATE_WIDE __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define PLATE_WIDE
#endif
