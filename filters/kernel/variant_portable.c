/* The kernel for every machine: two particles at once (SSE2, NEON), or one with other compilers. */
#define W 2
#include "histories.h"
#include "steps.h"
const Variant variant_portable = {advance, run_pass, run_histories};
