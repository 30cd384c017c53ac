// Small matrices whose rows are held in vectors, for two cases by one text.
//   T = double: one problem; a row of n numbers fills ceil(n / W) vectors, the last one padded.
//   T = vd:     W problems at once, one a lane; a row of n numbers is n vectors.
// Symmetric matrices are kept as their upper half. A covariance is a sum of squares of rows, and factors of it are
// found by elimination, so none ever loses its symmetry or becomes indefinite.
#pragma once
#include "lanes.h"

template <class T> constexpr unsigned PER = sizeof(vd) / sizeof(T);  // numbers in a vector
template <class T> constexpr int vectors(int n) { return (n + PER<T> - 1) / PER<T>; }
template <class T> static inline T* numbers(vd* row) { return (T*)row; }
template <class T> static inline const T* numbers(const vd* row) { return (const T*)row; }

// W vectors become their transpose, in log2(W) exchanges of halves.
template <int H, int... LANE> static inline void exchange(vd* v, std::integer_sequence<int, LANE...>) {
  for (int i = 0; i < W; i++)
    if (!(i & H)) {
      const vd a = v[i], b = v[i + H];
#ifdef __clang__
      v[i] = __builtin_shufflevector(a, b, (LANE & H ? W + LANE - H : LANE)...);
      v[i + H] = __builtin_shufflevector(a, b, (LANE & H ? W + LANE : LANE + H)...);
#else
      v[i] = __builtin_shuffle(a, b, vl{(LANE & H ? W + LANE - H : LANE)...});
      v[i + H] = __builtin_shuffle(a, b, vl{(LANE & H ? W + LANE : LANE + H)...});
#endif
    }
  if constexpr (2 * H < W) exchange<2 * H>(v, std::integer_sequence<int, LANE...>());
}
static inline void transpose(vd* v) { exchange<1>(v, std::make_integer_sequence<int, W>()); }

enum Into { SET, ADD, SUBTRACT };
enum Half { WHOLE, UPPER, LOWER };
enum Terms { ALL, UP_TO_ROW, FROM_ROW };  // which rows enter row i of a product: all, 0 ... i, i ... end

// sum_s f[s, i] rows[s] for the rows i of a matrix; sizes are data here, so that one code serves all products.
template <class T> struct Product {
  const T* f;
  ptrdiff_t next_s, next_i;  // in f
  const vd* rows;
  ptrdiff_t next_row;
  int count;

  // A rows of B vectors from row i, vector j on, held in registers while s runs
  template <int A, int B> [[gnu::noinline]] void tile(vd* out, ptrdiff_t next_out, int i, int j, int from, int to, Into into) const {
    vd sum[A][B] = {};
    const T* g = f + next_i * i + next_s * from;
    const vd* row = rows + next_row * from + j;
    for (int s = from; s < to; s++, g += next_s, row += next_row)
      for (int a = 0; a < A; a++) {
        const T share = g[next_i * a];
        for (int b = 0; b < B; b++) sum[a][b] += share * row[b];
      }
    out += next_out * i + j;
    for (int a = 0; a < A; a++, out += next_out)
      for (int b = 0; b < B; b++) out[b] = into == SET ? sum[a][b] : into == ADD ? out[b] + sum[a][b] : out[b] - sum[a][b];
  }
  template <int A> void band(vd* out, ptrdiff_t next_out, int i, int L, Into into, Half half, Terms terms) const {
    const int from = terms == FROM_ROW ? i : 0, to = terms == UP_TO_ROW && i + A < count ? i + A : count;
    const int end = half == LOWER ? (i + A - 1) / PER<T> + 1 : L;
    int j = half == UPPER ? i / PER<T> : 0;
    for (; j + 4 <= end; j += 4) tile<A, 4>(out, next_out, i, j, from, to, into);
    if (end - j == 3) tile<A, 3>(out, next_out, i, j, from, to, into);
    if (end - j == 2) tile<A, 2>(out, next_out, i, j, from, to, into);
    if (end - j == 1) tile<A, 1>(out, next_out, i, j, from, to, into);
  }
  [[gnu::noinline]] void into(vd* out, ptrdiff_t next_out, int N, int L, Into into, Half half, Terms terms) const {
    int i = 0;
    for (; i + 4 <= N; i += 4) band<4>(out, next_out, i, L, into, half, terms);
    if (N - i == 3) band<3>(out, next_out, i, L, into, half, terms);
    if (N - i == 2) band<2>(out, next_out, i, L, into, half, terms);
    if (N - i == 1) band<1>(out, next_out, i, L, into, half, terms);
  }
};

// out (N rows) = or += or -= A rows, or A' rows where `transposed`, of `count` rows.
template <class T, int N, int LO, int LA, int LR>
static inline void multiply(vd (*out)[LO], const vd (*A)[LA], bool transposed, const vd (*rows)[LR], int count, Into into, Terms terms) {
  const ptrdiff_t along = 1, down = LA * PER<T>;
  Product<T>{numbers<T>(A[0]), transposed ? down : along, transposed ? along : down, rows[0], LR, count}.into(
      out[0], LO, N, vectors<T>(N), into, WHOLE, terms);
}

// One half of the sum of squares rows' rows; of `count` rows.
template <class T, int N, int LO, int LR>
static inline void squares(vd (*out)[LO], const vd (*rows)[LR], int count, Into into = SET, Half half = UPPER, Terms terms = ALL) {
  Product<T>{numbers<T>(rows[0]), LR * PER<T>, 1, rows[0], LR, count}.into(out[0], LO, N, vectors<T>(N), into, half, terms);
}

// 1 / sqrt(pivot), 0 where the pivot is not above the floor: what is known exactly has no direction.
template <class T> static inline T inverse_root(T pivot, T floor) { return pivot > floor ? 1.0 / F_sqrt(pivot) : T(); }

// The upper factor U of the first N columns of A = U'U, in place, zeros below; the columns to their right become U'^-1
// times them. A pivot that is not above its floor leaves a zero row.
template <class T, int N, int END, int L> static inline void eliminate(vd (*A)[L], const T* floor) {
  for (int j = 0; j < N; j++) {
    T* row = numbers<T>(A[j]);
    const T scale = inverse_root<T>(row[j], floor[j]);
    for (int i = j / PER<T> * PER<T>; i < j; i++) row[i] = T();
    for (int b = j / PER<T>; b < END; b++) A[j][b] *= scale;
    for (int i = j + 1; i < N; i++) {
      const T share = row[i];
      for (int b = i / PER<T>; b < END; b++) A[i][b] -= share * A[j][b];
    }
  }
}

// The same from the last row to the first: B = V V', V upper, kept as its transpose in the lower half; `right`, which
// is upper triangular but for its columns from N on, becomes V^-1 times itself.
template <class T, int N, int L, int LR> static inline void eliminate_upwards(vd (*B)[L], vd (*right)[LR]) {
  for (int j = N - 1; j >= 0; j--) {
    T* row = numbers<T>(B[j]);
    const T scale = inverse_root<T>(row[j], T());
    for (int b = 0; b <= j / PER<T>; b++) B[j][b] *= scale;
    for (int b = j / PER<T>; b < LR; b++) right[j][b] *= scale;
    for (int i = 0; i < j; i++) {
      const T share = row[i];
      for (int b = 0; b <= i / PER<T>; b++) B[i][b] -= share * B[j][b];
      for (int b = j / PER<T>; b < LR; b++) right[i][b] -= share * right[j][b];
    }
  }
}

// Upper factor of a covariance, whose rows are the offsets of its sigma points; rows of exactly known states are zero.
template <class T, int N, int L, int LR> [[gnu::noinline]] static void factor(const vd (*cov)[L], vd (*root)[LR]) {
  T floor[N];
  for (int i = 0; i < N; i++) {
    for (int b = i / PER<T>; b < vectors<T>(N); b++) root[i][b] = cov[i][b];
    floor[i] = numbers<T>(cov[i])[i] * (N * 2.220446049250313e-16);
  }
  eliminate<T, N, vectors<T>(N)>(root, floor);
}

// rows (N of them) become (U'U)^-1 times themselves; zero where U has a zero row.
template <class T, int N, int L, int LU> static inline void divide(vd (*rows)[L], const vd (*U)[LU]) {
  T inverse[N];
  for (int j = 0; j < N; j++) {
    const T* row = numbers<T>(U[j]);
    inverse[j] = row[j] > 0.0 ? 1.0 / row[j] : T();
    for (int b = 0; b < L; b++) rows[j][b] *= inverse[j];
    for (int i = j + 1; i < N; i++)
      for (int b = 0; b < L; b++) rows[i][b] -= row[i] * rows[j][b];
  }
  for (int j = N - 1; j >= 0; j--) {
    const T* row = numbers<T>(U[j]);
    for (int i = j + 1; i < N; i++)
      for (int b = 0; b < L; b++) rows[j][b] -= row[i] * rows[i][b];
    for (int b = 0; b < L; b++) rows[j][b] *= inverse[j];
  }
}

// Sum of the logarithms of the diagonal of a triangular matrix.
template <class T, int N, int L> static inline T log_diagonal(const vd (*U)[L]) {
  T sum = T(), group = T() + 1.0;
  for (int j = 0; j < N; j++) {
    group *= numbers<T>(U[j])[j];
    if (j % 6 == 5 || j == N - 1) sum += F_log(group), group = T() + 1.0;
  }
  return sum;
}
