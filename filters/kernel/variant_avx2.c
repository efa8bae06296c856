/* The kernel for x86-64 with AVX2: four particles at once. */
#include "machine.h"
#ifdef X86_VARIANTS
TARGET("avx2")
#define W 4
#include "histories.h"
#include "steps.h"
END_TARGET
const Variant variant_avx2 = {advance, run_pass, run_histories};
#else
typedef int nothing;
#endif
