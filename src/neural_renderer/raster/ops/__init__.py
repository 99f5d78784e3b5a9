"""The operations of the rasteriser, one a file: public function, torch operator, Warp kernels."""
