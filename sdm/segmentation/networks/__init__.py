"""U-Net and V-Net."""
