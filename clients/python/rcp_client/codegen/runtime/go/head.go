// Typed client of the gateway at URL, written by `rcpctl codegen --lang go`.
//
//	gateway := rcp.New("URL", token)
//	pose, err := rcp.AlphaSensorPose.Read(ctx, gateway)

package rcp
