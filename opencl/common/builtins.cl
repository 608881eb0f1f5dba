// Declarations of the OpenCL functions that the kernels call, for PoCL 3.0. Its own header declares all OpenCL functions in 18,000 lines and is
// read again for every program, which takes a third of the time in which a program is built. The declarations are the same as in that header,
// so the same machine code results. A call of any other OpenCL function is a compilation error in PoCL 3.0; declare the function here.

#define BUILTIN __attribute__((overloadable, const))
#define FOR_SIZES(declare, type, unsigned_type) \
    declare(type, unsigned_type) declare(type##2, unsigned_type##2) declare(type##3, unsigned_type##3) \
    declare(type##4, unsigned_type##4) declare(type##8, unsigned_type##8) declare(type##16, unsigned_type##16)
#define LIMITS(type, unsigned_type) \
    type BUILTIN min(type, type); type BUILTIN max(type, type); type BUILTIN clamp(type, type, type);
#define DISTANCES(type, unsigned_type) unsigned_type BUILTIN abs(type); unsigned_type BUILTIN abs_diff(type, type);
#define TRUTHS(type, unsigned_type) int BUILTIN any(type); int BUILTIN all(type);

FOR_SIZES(LIMITS, char, uchar) FOR_SIZES(LIMITS, uchar, uchar) FOR_SIZES(LIMITS, short, ushort) FOR_SIZES(LIMITS, ushort, ushort)
FOR_SIZES(LIMITS, int, uint) FOR_SIZES(LIMITS, uint, uint) FOR_SIZES(LIMITS, long, ulong) FOR_SIZES(LIMITS, ulong, ulong)
FOR_SIZES(LIMITS, float, float)
FOR_SIZES(DISTANCES, int, uint) FOR_SIZES(DISTANCES, uint, uint)
FOR_SIZES(TRUTHS, int, int)

size_t BUILTIN get_global_size(uint);
size_t BUILTIN get_global_id(uint);
size_t BUILTIN get_local_id(uint);
size_t BUILTIN get_group_id(uint);
void __attribute__((overloadable, convergent)) barrier(cl_mem_fence_flags);
