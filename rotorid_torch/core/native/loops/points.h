// Results of a function at many points, W of them in lanes.
// Needs results<T> with RESULTS results; prepare.
#include "lanes.h"

// x [count, NX], u [count, NU] -> out [RESULTS, count].
extern "C" void results_at(int64_t count, const double* x, const double* u, const double* th, double* out) {
  Array<double> c(NC);
  prepare(th, c.data());
  vd X[NX + 1], U[NU + 1], here[RESULTS];
  for (int64_t first = 0; first < count; first += W) {
    const int used = count - first < W ? count - first : W;
    for (int l = 0; l < W; l++) {
      const int64_t k = first + (l < used ? l : 0);
      for (int i = 0; i < NX; i++) X[i][l] = x[k * NX + i];
      for (int i = 0; i < NU; i++) U[i][l] = u[k * NU + i];
    }
    results<vd>(X, U, c.data(), here);
    for (int i = 0; i < RESULTS; i++) memcpy(out + i * count + first, &here[i], used * sizeof(double));
  }
}
