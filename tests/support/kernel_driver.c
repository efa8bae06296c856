/* Calls of the kernel from a file, for machines and compilers that have no Python here: standard input to output.

   A call: sizes in bytes of filter, steps, readings, log_relocation, state, estimates, records; past, count; outlier_m2;
   then these seven blocks. An answer: what `advance` returned, then estimates and records. */
#include <stdio.h>
#include <stdlib.h>
#include "layout.h"

extern const Variant variant_portable;

int main(void) {
    int64_t head[9];
    double outlier_m2;
    while (fread(head, 8, 9, stdin) == 9 && fread(&outlier_m2, 8, 1, stdin) == 1) {
        char *block[7];
        for (int i = 0; i < 7; i++) {
            block[i] = malloc((size_t)head[i] + 1);
            if (!block[i] || fread(block[i], 1, (size_t)head[i], stdin) != (size_t)head[i]) return 1;
        }
        Guard guard = {(double *)block[3], outlier_m2};
        int64_t done = variant_portable.advance((Filter *)block[0], (Step *)block[1], (int)head[7], (int)head[8],
                                                (Reading *)block[2], head[3] ? &guard : NULL, (double *)block[4],
                                                (double *)block[5], (double *)block[6]);
        fwrite(&done, 8, 1, stdout);
        for (int i = 5; i < 7; i++) fwrite(block[i], 1, (size_t)head[i], stdout);
        for (int i = 0; i < 7; i++) free(block[i]);
    }
    return 0;
}
