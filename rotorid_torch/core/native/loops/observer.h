// A model that follows measured flights with gains that are known, and its derivatives: x += K (y - h(x)) at each
// sample. Residuals, which are the innovations, and their derivatives are whitened by W, sample by sample; gains and
// W have zeros where a measurement is missing.
#define TANGENTS_ALONE
#include "sensitivity.h"

static const int lane_count = W;  // W itself is the whitening matrix below

struct Following {
  const double* y;      // [F, n, NY], NaN = missing
  const double* gain;   // [F, n, NX, NY]
  const double* white;  // [F, n, NY, NY] lower triangular
};

// One flight; calls sink(rows, count) with whitened rows in order of time where derivatives are wanted. Its cost.
template <bool DERIVATIVES, class Sink>
static double follow(const Problem& p, const Following& by, int which, int length, Sensitivity& s, Sink sink) {
  double out[NY], e[NY], white[NY], cost = 0.0;
  memcpy(s.x, p.x0 + (size_t)which * NX, sizeof s.x);
  for (int i = 0; i < STARTS; i++) s.S[i][FIRST_X0 + i] = 1.0;
  int gathered = 0;
  for (int t = 0; t < length; t++) {
    const size_t sample = (size_t)which * p.n + t;
    const bool last = t == length - 1;
    const double *u0 = p.u + sample * NU, *u1 = last ? u0 : u0 + NU;
    const double *K = by.gain + sample * NX * NY, *W = by.white + sample * NY * NY, *y = by.y + sample * NY;
    if (DERIVATIVES) load_path(p, sample, last, s);
    outputs_linear(s.x, u0, p.c, out, s.C, s.L);
    for (int a = 0; a < NY; a++) e[a] = __builtin_isnan(y[a]) ? 0.0 : y[a] - out[a];
    for (int a = 0; a < NY; a++) {
      white[a] = 0.0;
      for (int c = 0; c <= a; c++) white[a] += W[a * NY + c] * e[c];
      cost += 0.5 * white[a] * white[a];
    }
    for (int i = 0; i < NX; i++) for (int a = 0; a < NY; a++) s.x[i] += K[i * NY + a] * e[a];
    if (DERIVATIVES) {
      for (int b = 0; b < MOVING; b++) {
        output_rows(b, s, p.c);
        vd dy[NY];
        for (int a = 0; a < NY; a++) dy[a] = *(vd*)&s.raw[a][lane_count * b];
        for (int a = 0; a < NY; a++) {
          vd sum = vd{};
          for (int c = 0; c <= a; c++) sum += W[a * NY + c] * dy[c];
          *(vd*)&s.rows[gathered + a][lane_count * b] = sum;
        }
        for (int i = 0; i < NX; i++) {
          vd sum = *(vd*)&s.S[i][lane_count * b];
          for (int a = 0; a < NY; a++) sum -= K[i * NY + a] * dy[a];
          *(vd*)&s.S[i][lane_count * b] = sum;
        }
      }
      for (int a = 0; a < NY; a++) s.rows[gathered + a][RESIDUAL] = white[a];
      gathered += NY;
      if (gathered == ROWS || last) { sink(s.rows, gathered); gathered = 0; }
    }
    if (last) break;
    onward<DERIVATIVES>(u0, u1, p.c, p.dt, s);
  }
  return cost;
}

// Flights followed: cost [F]; where H [F, columns, columns] is given the upper part of each one's normal equations, and
// rows [F, n, NY, columns] where these are. order [columns]: column of each entry of the result, the residual last.
extern "C" void followed(int count, int n, double dt, const int* length, const double* u, const double* path, const double* y,
                         const double* gain, const double* white, const double* x0, const double* th, double* cost, int columns,
                         const int* order, double* H, double* rows, int threads) {
  Array<double> c(NC);
  prepare(th, c.data());
  const Problem p{n, dt, u, path, nullptr, x0, c.data(), nullptr, nullptr, nullptr};
  const Following by{y, gain, white};
  const Order by_column{columns, order};
  each(count, threads, [&](int64_t f) {
    struct Room { Sensitivity s; alignas(64) Row upper[WIDTH] = {}; };
    Array<Room> room(1);
    if (!H && !rows) { cost[f] = follow<false>(p, by, f, length[f], room->s, [](const Row*, int) {}); return; }
    double* row = rows ? rows + (size_t)f * n * NY * columns : nullptr;
    cost[f] = follow<true>(p, by, f, length[f], room->s, [&](const Row* made, int k) {
      if (H) multiply_out(made, k, room->upper);
      if (row) row = by_column.rows(made, k, row);
    });
    if (H) by_column.symmetric(room->upper, H + (size_t)f * columns * columns);
  });
}
