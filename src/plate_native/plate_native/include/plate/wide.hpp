// The macro PLATE_WIDE compiles a function for several vector widths. At program start, the loader
// of the operating system selects the version for the processor.
//
// The results do not depend on the vector width. The order of the terms in sums is fixed, and no
// instruction combines a product and a sum. Vectors of 512 bits are excluded. For such vectors, GCC
// 12 generates code that reads beyond the ends of arrays (test_native.py).
#pragma once

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define PLATE_WIDE __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define PLATE_WIDE
#endif
