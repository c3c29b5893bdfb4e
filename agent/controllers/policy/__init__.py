"""The controller `policy`: flies a policy that was trained outside and saved to a file."""
