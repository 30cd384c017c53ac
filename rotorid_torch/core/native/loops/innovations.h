// The extended Kalman filter with exact derivatives by all unknowns, columns in SIMD lanes, and their normal equations.
// The loop of `sensitivity.h` carries states and the upper half of their covariance as one vector of NX numbers, first
// the N states; its NY outputs are M measured ones, then the entries of H = dh/dx that are not zero (H_ROW, H_COL),
// then those of the upper half of R (R_ROW, R_COL). At each sample the outputs correct both.
#define TANGENTS_ALONE
#include "sensitivity.h"

enum { SPREADS = M * (M + 1) / 2, SAMPLE_ROWS = M + SPREADS, BUNDLE = SAMPLE_ROWS * (64 / SAMPLE_ROWS > 0 ? 64 / SAMPLE_ROWS : 1) };

constexpr double ROOT_HALF = 0.70710678118654752440;

struct Flights {
  int n;               // samples of the longest flight
  double dt;
  const double* u;     // [F, n, NU]
  const double* path;  // [F, n, NU, PATH]
  const double* y;     // [F, n, M], NaN = missing
  const double* x0;    // [F, N]
  const double* P0;    // [F, N, N]
  const double* c;
};
struct Record {        // of all flights; null where not asked for
  double* cost;        // [F]
  int* lost;           // [F, 2] sample and state where the filter diverged, -1 where it did not
  double* innovations; // [F, n, M]
  double* spreads;     // [F, n, M, M]
  double* states;      // [F, n, N]
  double* covariances; // [F, n, N, N]
  double* gains;       // [F, n, N, M]
  double* white;       // [F, n, M, M]
};

static inline int place(int i, int j) { return i <= j ? N + i * N - i * (i - 1) / 2 + j - i : place(j, i); }

// What one sample says: innovation e, its covariance's inverse factor W, gain and all that the derivatives need.
struct Update {
  bool there[M];
  double H[M][N], PH[N][M], W[M][M], K[N][M], white[M], s[M], log_determinant;
};

// Lower factor's inverse W of the symmetric S [M, M]; false where S is not positive definite.
static bool inverse_factor(const double (*S)[M], double (*W)[M], double& log_determinant) {
  double L[M][M];
  log_determinant = 0.0;
  for (int i = 0; i < M; i++) {
    for (int j = 0; j <= i; j++) {
      double sum = S[i][j];
      for (int k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
      if (i != j) { L[i][j] = sum / L[j][j]; continue; }
      if (!(sum > 0.0) || !__builtin_isfinite(sum)) return false;
      L[i][i] = __builtin_sqrt(sum);
      log_determinant += 2.0 * __builtin_log(L[i][i]);
    }
  }
  for (int j = 0; j < M; j++)
    for (int i = 0; i < M; i++) {
      double sum = i == j ? 1.0 : 0.0;
      for (int k = j; k < i; k++) sum -= L[i][k] * W[k][j];
      W[i][j] = i < j ? 0.0 : sum / L[i][i];
    }
  return true;
}

// Corrects x by the sample y whose outputs' values stand in `out`; S is the innovation's covariance.
static bool corrected(const double* y, const double* out, double* x, Update& v, double (*S)[M]) {
  for (int i = 0; i < M; i++) {
    v.there[i] = !__builtin_isnan(y[i]);
    for (int j = 0; j < N; j++) v.H[i][j] = 0.0;
  }
  for (int q = 0; q < NH; q++) if (v.there[H_ROW[q]]) v.H[H_ROW[q]][H_COL[q]] = out[M + q];
  for (int i = 0; i < N; i++) for (int a = 0; a < M; a++) v.PH[i][a] = 0.0;
  for (int q = 0; q < NH; q++) {
    const int a = H_ROW[q], j = H_COL[q];
    for (int i = 0; i < N; i++) v.PH[i][a] += x[place(i, j)] * v.H[a][j];
  }
  for (int a = 0; a < M; a++) for (int b = 0; b < M; b++) S[a][b] = a == b && !v.there[a] ? 1.0 : 0.0;
  for (int q = 0; q < NH; q++) for (int b = 0; b < M; b++) S[H_ROW[q]][b] += v.H[H_ROW[q]][H_COL[q]] * v.PH[H_COL[q]][b];
  for (int q = 0; q < NR; q++) {
    const int a = R_ROW[q], b = R_COL[q];
    if (!v.there[a] || !v.there[b]) continue;
    S[a][b] += out[M + NH + q];
    if (a != b) S[b][a] += out[M + NH + q];
  }
  if (!inverse_factor(S, v.W, v.log_determinant)) return false;
  for (int a = 0; a < M; a++) {
    v.white[a] = 0.0;
    for (int b = 0; b <= a; b++) if (v.there[b]) v.white[a] += v.W[a][b] * (y[b] - out[b]);
  }
  double PW[N][M];  // P H' W', of which the rows' products are what the covariance loses
  for (int i = 0; i < N; i++) for (int a = 0; a < M; a++) {
    PW[i][a] = 0.0;
    for (int b = 0; b <= a; b++) PW[i][a] += v.PH[i][b] * v.W[a][b];
  }
  for (int b = 0; b < M; b++) {
    v.s[b] = 0.0;
    for (int a = b; a < M; a++) v.s[b] += v.W[a][b] * v.white[a];
  }
  for (int i = 0; i < N; i++) {
    for (int b = 0; b < M; b++) {
      v.K[i][b] = 0.0;
      for (int a = b; a < M; a++) v.K[i][b] += PW[i][a] * v.W[a][b];
    }
    for (int a = 0; a < M; a++) x[i] += PW[i][a] * v.white[a];
    for (int j = i; j < N; j++) for (int a = 0; a < M; a++) x[place(i, j)] -= PW[i][a] * PW[j][a];
  }
  return true;
}

// Tangents of vector b through the correction; their rows in `rows`.
static void correct_tangents(int b, Sensitivity& s, const Update& v, Row* rows) {
  auto raw = [&](int i) { return *(vd*)&s.raw[i][W * b]; };
  auto tangent = [&](int i) -> vd& { return *(vd*)&s.S[i][W * b]; };
  vd dPH[N][M], dS[M][M], dy[M];
  for (int a = 0; a < M; a++) dy[a] = v.there[a] ? raw(a) : vd{};
  for (int i = 0; i < N; i++) for (int a = 0; a < M; a++) dPH[i][a] = vd{};
  for (int a = 0; a < M; a++) for (int c = 0; c < M; c++) dS[a][c] = vd{};
  for (int q = 0; q < NH; q++) {  // dP H'
    const int a = H_ROW[q], j = H_COL[q];
    const double h = v.H[a][j];
    if (h != 0.0) for (int i = 0; i < N; i++) dPH[i][a] += h * tangent(place(i, j));
  }
  if (H_VARIES) for (int q = 0; q < NH; q++) {  // dH P H'
    const int a = H_ROW[q], j = H_COL[q];
    if (v.there[a]) for (int c = 0; c < M; c++) dS[a][c] += v.PH[j][c] * raw(M + q);
  }
  if (H_VARIES) for (int q = 0; q < NH; q++) {  // P dH', P before the correction
    const int a = H_ROW[q], j = H_COL[q];
    if (v.there[a]) for (int i = 0; i < N; i++) dPH[i][a] += s.before[place(i, j)] * raw(M + q);
  }
  for (int q = 0; q < NH; q++) {
    const int a = H_ROW[q], j = H_COL[q];
    const double h = v.H[a][j];
    if (h != 0.0) for (int c = 0; c < M; c++) dS[a][c] += h * dPH[j][c];
  }
  for (int q = 0; q < NR; q++) {
    const int a = R_ROW[q], c = R_COL[q];
    if (!v.there[a] || !v.there[c]) continue;
    dS[a][c] += raw(M + NH + q);
    if (a != c) dS[c][a] += raw(M + NH + q);
  }
  vd half[M][M];  // W dS
  for (int a = 0, r = M; a < M; a++) {
    vd sum = vd{};
    for (int c = 0; c <= a; c++) sum += v.W[a][c] * dy[c];
    *(vd*)&rows[a][W * b] = sum;
    for (int c = 0; c < M; c++) {
      half[a][c] = vd{};
      for (int d = 0; d <= a; d++) half[a][c] += v.W[a][d] * dS[d][c];
    }
    for (int c = 0; c <= a; c++, r++) {
      vd spread = vd{};
      for (int d = 0; d <= c; d++) spread += v.W[c][d] * half[a][d];
      *(vd*)&rows[r][W * b] = (a == c ? ROOT_HALF : 1.0) * spread;
    }
  }
  vd X[N][N];  // (dPH - K dS / 2) K', the covariance's loss with its transpose
  for (int i = 0; i < N; i++) {
    vd line[M], more = vd{};
    for (int a = 0; a < M; a++) {
      vd KdS = vd{};
      for (int c = 0; c < M; c++) KdS += v.K[i][c] * dS[c][a];
      line[a] = dPH[i][a] - 0.5 * KdS;
      more += v.s[a] * (dPH[i][a] - KdS) - v.K[i][a] * dy[a];
    }
    tangent(i) += more;
    for (int j = 0; j < N; j++) {
      X[i][j] = vd{};
      for (int a = 0; a < M; a++) X[i][j] += v.K[j][a] * line[a];
    }
  }
  for (int i = 0; i < N; i++) for (int j = i; j < N; j++) tangent(place(i, j)) -= X[i][j] + X[j][i];
}

// One flight; calls sink(rows, count) with rows in order of time where derivatives are wanted. False where it diverged.
template <bool DERIVATIVES, class Sink>
static bool filter(const Flights& p, const Record& to, int which, int length, Sensitivity& s, Row* rows, Sink sink) {
  double out[NY], S[M][M], cost = 0.0;
  Update v;
  memcpy(s.x, p.x0 + (size_t)which * N, N * sizeof(double));
  for (int i = 0; i < STARTS; i++) s.S[i][FIRST_X0 + i] = 1.0;
  for (int i = 0; i < N; i++) for (int j = i; j < N; j++) s.x[place(i, j)] = p.P0[((size_t)which * N + i) * N + j];
  const Problem controls{p.n, p.dt, p.u, p.path, nullptr, nullptr, p.c, nullptr, nullptr, nullptr};
  int gathered = 0;
  to.cost[which] = __builtin_inf();
  for (int t = 0; t < length; t++) {
    const size_t sample = (size_t)which * p.n + t;
    const bool last = t == length - 1;
    const double *u0 = p.u + sample * NU, *u1 = last ? u0 : u0 + NU;
    if (DERIVATIVES) load_path(controls, sample, last, s);
    outputs_linear(s.x, u0, p.c, out, s.C, s.L);
    memcpy(s.before, s.x, sizeof s.x);
    int wrong = -1;
    for (int i = N - 1; i >= 0; i--) if (!__builtin_isfinite(s.x[i]) || !__builtin_isfinite(s.x[place(i, i)])) wrong = i;
    const bool sound = wrong < 0 && corrected(p.y + sample * M, out, s.x, v, S);
    for (int i = N - 1; sound && i >= 0; i--) if (!__builtin_isfinite(s.x[i])) wrong = i;
    if (!sound || wrong >= 0) {
      to.lost[2 * which] = t;
      to.lost[2 * which + 1] = wrong < 0 ? 0 : wrong;
      return false;
    }
    for (int a = 0; a < M; a++) cost += 0.5 * v.white[a] * v.white[a];
    cost += 0.5 * v.log_determinant;
    if (to.innovations) for (int a = 0; a < M; a++) to.innovations[sample * M + a] = v.there[a] ? p.y[sample * M + a] - out[a] : __builtin_nan("");
    if (to.spreads) memcpy(to.spreads + sample * M * M, S, sizeof S);
    if (to.states) memcpy(to.states + sample * N, s.x, N * sizeof(double));
    if (to.covariances) for (int i = 0; i < N; i++) for (int j = 0; j < N; j++) to.covariances[(sample * N + i) * N + j] = s.x[place(i, j)];
    for (int a = 0; a < M; a++) {
      if (to.gains) for (int i = 0; i < N; i++) to.gains[(sample * N + i) * M + a] = v.there[a] ? v.K[i][a] : 0.0;
      if (to.white) for (int b = 0; b < M; b++) to.white[(sample * M + a) * M + b] = v.there[a] && v.there[b] ? v.W[a][b] : 0.0;
    }
    if (DERIVATIVES) {
      for (int b = 0; b < MOVING; b++) {
        output_rows(b, s, p.c);
        correct_tangents(b, s, v, rows + gathered);
      }
      for (int a = 0, r = M; a < M; a++) {
        rows[gathered + a][RESIDUAL] = v.white[a];
        for (int c = 0; c <= a; c++, r++)
          rows[gathered + r][RESIDUAL] = !v.there[a] || !v.there[c] ? 0.0 : a == c ? ROOT_HALF * (v.white[a] * v.white[a] - 1.0) : v.white[a] * v.white[c];
      }
      gathered += SAMPLE_ROWS;
      if (gathered == BUNDLE || last) { sink(rows, gathered); gathered = 0; }
    }
    if (last) break;
    onward<DERIVATIVES>(u0, u1, p.c, p.dt, s);
  }
  to.cost[which] = cost;
  return true;
}

// Flights filtered; and, where H [F, columns, columns] is given, the upper part of each one's normal equations.
// order [columns]: column of each entry of the result, the residual last. rows [F, n, SAMPLE_ROWS, columns] or null.
extern "C" void innovations(int count, int n, double dt, const int* length, const double* u, const double* path, const double* y,
                            const double* x0, const double* P0, const double* th, double* cost, int* lost, double* innovations, double* spreads,
                            double* states, double* covariances, double* gains, double* white, int columns, const int* order, double* H, double* rows, int threads) {
  Array<double> c(NC);
  prepare(th, c.data());
  const Flights p{n, dt, u, path, y, x0, P0, c.data()};
  const Record to{cost, lost, innovations, spreads, states, covariances, gains, white};
  const Order by_column{columns, order};
  each(count, threads, [&](int64_t f) {
    struct Room { Sensitivity s; alignas(64) Row bundle[BUNDLE] = {}; alignas(64) Row upper[WIDTH] = {}; };
    Array<Room> room(1);
    if (!H && !rows) { filter<false>(p, to, f, length[f], room->s, room->bundle, [](const Row*, int) {}); return; }
    double* row = rows ? rows + (size_t)f * n * SAMPLE_ROWS * columns : nullptr;
    filter<true>(p, to, f, length[f], room->s, room->bundle, [&](const Row* made, int k) {
      if (H) multiply_out(made, k, room->upper);
      if (row) row = by_column.rows(made, k, row);
    });
    if (H) by_column.symmetric(room->upper, H + (size_t)f * columns * columns);
  });
}
