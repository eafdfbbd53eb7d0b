/* A height field, phi = z - h(x, y). own: size_x size_y 1/cell x y | coefficients. */
static void octo_world_heights(const double *own, const double *point, int order, double *jet) {
  double weights[2][16], inner[4][4], height[4][4];
  int first[2];
  for (int axis = 0; axis < 2; axis++) {
    double image[4];
    octo_world_image((point[axis] - own[3 + axis]) * own[2], own[axis], image);
    first[axis] = octo_world_weights(image, own[axis], own[2], weights[axis]);
  }
  const int stride = (int)own[1] + 4;
  const double *row = own + 5 + (size_t)first[0] * stride + first[1];
  for (int a = 0; a < 4; a++, row += stride)
    for (int d = 0; d < 4; d++)
      inner[a][d] = row[0] * weights[1][d] + row[1] * weights[1][4 + d] +
                    row[2] * weights[1][8 + d] + row[3] * weights[1][12 + d];
  for (int f = 0; f <= order; f++)
    for (int d = 0; d < 4; d++)
      height[f][d] = inner[0][d] * weights[0][f] + inner[1][d] * weights[0][4 + f] +
                     inner[2][d] * weights[0][8 + f] + inner[3][d] * weights[0][12 + f];
  for (int total = 0; total <= order; total++)
    for (int f = total; f >= 0; f--)
      for (int e = total - f; e >= 0; e--) *jet++ = e + f == total ? -height[f][e] : 0.0;
  jet -= (order + 1) * (order + 2) * (order + 3) / 6;
  jet[0] += point[2];
  if (order > 0) jet[3] = 1.0;
}
