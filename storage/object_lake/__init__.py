"""The lake of a store on an object store with the S3 API: published, verified, and read through a cache."""
