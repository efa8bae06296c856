/* The kernel for x86-64 with AVX-512: eight particles at once. */
#include "machine.h"
#ifdef X86_VARIANTS
TARGET("avx512f,avx512dq,avx512vl")
#define W 8
#include "histories.h"
#include "steps.h"
END_TARGET
const Variant variant_avx512 = {advance, run_pass, run_histories};
#else
typedef int nothing;
#endif
