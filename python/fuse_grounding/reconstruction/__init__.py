"""Maps of anybody's photos: data sets, standalone training, camera paths, poses by COLMAP.

`fuse_grounding.splat` holds the model and the trainer; this package is what `fuse splat` adds.
"""
