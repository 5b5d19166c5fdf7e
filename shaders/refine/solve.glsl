// Symmetric systems of six, by a Cholesky factorisation of the matrix scaled to a unit diagonal. It uses shared memory and
// loops that are not unrolled: unrolled loops or indexed register arrays take seconds to compile.
shared float matrix[SUMS];          // upper triangle of the matrix; the rest is the caller's
shared float factor[36], scales[6];
shared bool positive;               // whether all scaled pivots of the matrix are above the least
shared float columns[36];           // column j from 6 j

// Copies the result of sum() in totals[] to the matrix. Ends with a barrier.
void keep_totals() {
  if (lane < SUMS) matrix[lane] = totals[lane];
  barrier();
}

// Factorises `matrix` with its diagonal times 1 + damping. Ends with a barrier.
void factorise(float damping, float least_pivot) {
  if (lane == 0u) {
    positive = true;
    [[dont_unroll]] for (int i = 0; i < 6; ++i) {
      float d = matrix[TRIANGLE(i, i)];
      positive = positive && d > 0.0 && is_finite(d);
      scales[i] = positive ? inversesqrt(d) : 1.0;
    }
    [[dont_unroll]] for (int i = 0; i < 6; ++i)
      [[dont_unroll]] for (int j = 0; j <= i; ++j) {
        float p = i == j ? 1.0 + damping : matrix[TRIANGLE(j, i)] * scales[i] * scales[j];
        [[dont_unroll]] for (int k = 0; k < j; ++k) p -= factor[6 * i + k] * factor[6 * j + k];
        if (i == j) positive = positive && p > least_pivot;
        factor[6 * i + j] = i == j ? sqrt(max(p, least_pivot)) : p / factor[7 * j];
      }
  }
  barrier();
}

// Each of the first `count` columns b becomes the solution of A x = b. Ends with a barrier.
void solve(uint count) {
  int first = 6 * int(lane);
  if (lane < count) {
    [[dont_unroll]] for (int i = 0; i < 6; ++i) {
      float t = columns[first + i] * scales[i];
      [[dont_unroll]] for (int k = 0; k < i; ++k) t -= factor[6 * i + k] * columns[first + k];
      columns[first + i] = t / factor[7 * i];
    }
    [[dont_unroll]] for (int i = 5; i >= 0; --i) {
      float t = columns[first + i];
      [[dont_unroll]] for (int k = i + 1; k < 6; ++k) t -= factor[6 * k + i] * columns[first + k];
      columns[first + i] = t / factor[7 * i];
    }
    [[dont_unroll]] for (int i = 0; i < 6; ++i) columns[first + i] *= scales[i];
  }
  barrier();
}

// The inverse of the matrix that was factorised, into `columns`.
void invert() {
  if (lane < 36u) columns[lane] = lane % 7u == 0u ? 1.0 : 0.0;
  barrier();
  solve(6u);
}
