/* The digest of the sources the library was built from, and the processor level it can run at. */
#include <stdint.h>

#define PUBLIC __attribute__((visibility("default")))

PUBLIC const char engine_digest[] = DIGEST;

/* Return the highest processor level that can run here: 1 on every processor of the architecture, else
 * the x86-64 levels 3 (AVX2) and 4 (AVX-512) of the System V ABI. */
PUBLIC int64_t engine_level(void) {
#ifdef __x86_64__
    __builtin_cpu_init();
    int avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2")
            && __builtin_cpu_supports("fma");
    if (avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq")
        && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw")
        && __builtin_cpu_supports("avx512cd"))
        return 4;
    if (avx2) return 3;
#endif
    return 1;
}
