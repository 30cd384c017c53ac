// SIMD lanes and the functions on them. W doubles a vector: as many as the widest register of this machine holds,
// for wider ones GCC takes apart through memory.
// Only small headers: those of <cmath>, <memory>, <thread> and <vector> take a compiler half a second for each model.
#pragma once
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <pthread.h>
#include <utility>

#if defined(__AVX512F__)
enum { W = 8 };
#elif defined(__AVX2__)
enum { W = 4 };
#else
enum { W = 2 };
#endif
typedef double vd __attribute__((vector_size(8 * W)));
typedef long long vl __attribute__((vector_size(8 * W)));

static inline vd lanes(double x) { return vd{} + x; }

// Zeros that go where the block ends; of one thing, that thing.
template <class T> class Array {
  T* const first;
 public:
  explicit Array(size_t n) : first(new T[n]()) {}
  Array(const Array&) = delete;
  ~Array() { delete[] first; }
  T* data() { return first; }
  T* operator->() { return first; }
  T& operator[](size_t k) { return first[k]; }
};

template <class Work> static void* on_thread(void* work) { (*(const Work*)work)(); return nullptr; }

// work(i) for each i below count, in order by whoever is free.
template <class Work> static void each(int64_t count, int threads, const Work& work) {
  int64_t next = 0;
  auto share = [&] { for (int64_t i; (i = __atomic_fetch_add(&next, 1, __ATOMIC_RELAXED)) < count;) work(i); };
  Array<pthread_t> others(threads);
  int begun = 0;  // as many as the system gives
  while (begun + 1 < threads && begun + 1 < count && !pthread_create(&others[begun], nullptr, on_thread<decltype(share)>, &share)) begun++;
  share();
  while (begun) pthread_join(others[--begun], nullptr);
}

// The same in groups of W lanes: work(first, used).
template <class Work> static void each_group(int64_t count, int threads, const Work& work) {
  each((count + W - 1) / W, threads, [&](int64_t g) { work(g * W, (int)(count - g * W < W ? count - g * W : W)); });
}

// Sine and cosine together, for |x| < 1e5, error below 2 ulp: argument reduced by pi/2 in three parts (Cody and
// Waite 1980), kernels of fdlibm (Sun Microsystems 1993).
static inline void SinCos(double x, double& s, double& c) { s = __builtin_sin(x); c = __builtin_cos(x); }
static inline double F_sin(double x) { return __builtin_sin(x); }
static inline double F_cos(double x) { return __builtin_cos(x); }
static inline void SinCos(vd x, vd& s, vd& c) {
  const double ROUND = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer in the low bits
  const vd shifted = x * 0.63661977236758134308 + ROUND;
  const vd turns = shifted - ROUND;
  const vl quadrant = (vl)shifted;
  vd r = x - turns * 1.57079632673412561417e+00;
  r = r - turns * 6.07710050630396597660e-11;
  r = r - turns * 2.02226624879595063154e-21;
  const vd z = r * r;
  vd odd = 1.58969099521155010221e-10 * z - 2.50507602534068634195e-08;
  odd = odd * z + 2.75573137070700676789e-06;
  odd = odd * z - 1.98412698298579493134e-04;
  odd = odd * z + 8.33333333332248946124e-03;
  odd = odd * z - 1.66666666666666324348e-01;
  vd even = -1.13596475577881948265e-11 * z + 2.08757232129817482790e-09;
  even = even * z - 2.75573143513906633035e-07;
  even = even * z + 2.48015872894767294178e-05;
  even = even * z - 1.38888888888741095749e-03;
  even = even * z + 4.16666666666666019037e-02;
  const vd sine = r + r * z * odd, cosine = 1.0 - 0.5 * z + z * z * even;
  const vl swap = (quadrant & 1) != 0;
  const vl sine_sign = (quadrant & 2) << 62, cosine_sign = ((quadrant + 1) & 2) << 62;
  s = (vd)((vl)(swap ? cosine : sine) ^ sine_sign);
  c = (vd)((vl)(swap ? sine : cosine) ^ cosine_sign);
}

// Other functions: lane by lane, or glibc's vector versions (4 ulp) where there are any, by their ABI names.
#define LANE_BY_LANE(name) \
  static inline double F_##name(double x) { return __builtin_##name(x); } \
  static inline vd F_##name(vd x) { for (int i = 0; i < W; i++) x[i] = __builtin_##name(x[i]); return x; }
#define LANE_BY_LANE2(name) \
  static inline double F_##name(double x, double y) { return __builtin_##name(x, y); } \
  static inline vd F_##name(vd x, vd y) { for (int i = 0; i < W; i++) x[i] = __builtin_##name(x[i], y[i]); return x; }
#if defined(__x86_64__) && defined(__GLIBC__) && __GLIBC_MINOR__ >= 35
#if defined(__AVX512F__)
#define VECTOR_NAME(name) _ZGVeN8v_##name
#define VECTOR_NAME2(name) _ZGVeN8vv_##name
#elif defined(__AVX2__)
#define VECTOR_NAME(name) _ZGVdN4v_##name
#define VECTOR_NAME2(name) _ZGVdN4vv_##name
#else
#define VECTOR_NAME(name) _ZGVbN2v_##name
#define VECTOR_NAME2(name) _ZGVbN2vv_##name
#endif
#define VECTOR(name) \
  extern "C" vd VECTOR_NAME(name)(vd); \
  static inline double F_##name(double x) { return __builtin_##name(x); } \
  static inline vd F_##name(vd x) { return VECTOR_NAME(name)(x); }
#define VECTOR2(name) \
  extern "C" vd VECTOR_NAME2(name)(vd, vd); \
  static inline double F_##name(double x, double y) { return __builtin_##name(x, y); } \
  static inline vd F_##name(vd x, vd y) { return VECTOR_NAME2(name)(x, y); }
#else
#define VECTOR(name) LANE_BY_LANE(name)
#define VECTOR2(name) LANE_BY_LANE2(name)
#endif
LANE_BY_LANE(sqrt)
VECTOR(exp)
VECTOR(log)
VECTOR(log1p)
VECTOR(tanh)
VECTOR(asin)
VECTOR(acos)
VECTOR(atan)
VECTOR2(atan2)
VECTOR2(pow)
template <class T> static inline T F_sigmoid(T x) { return 1.0 / (1.0 + F_exp(-x)); }
static inline double F_abs(double a) { return __builtin_fabs(a); }
static inline vd F_abs(vd a) { return a < 0.0 ? -a : a; }
template <class T> static inline T F_maximum(T a, T b) { return a > b ? a : b; }
template <class T> static inline T F_minimum(T a, T b) { return a < b ? a : b; }
