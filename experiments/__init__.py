"""The paper's tables and this package's own studies, one script a table, run from a clone:

    python -m experiments ablation --scale small

`runs` is what they share. The baselines live beside the tables that use them: `pointnet`,
`pointnet_training` (PointNet++) and `r2s2r` (R2S2R); pi_RD is in `rope_real`.
"""
