"""Cases, readers, patches, augmentation and targets."""
