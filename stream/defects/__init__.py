"""What is wrong with samples: outputs that stand still, outliers, values that stand for lost samples."""
